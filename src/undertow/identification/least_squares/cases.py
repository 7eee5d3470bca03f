"""The paper's eleven ways to smooth velocity and acceleration before least squares (Tables 1 to 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import savgol_filter

from undertow.errors import UndertowError
from undertow.typing import Array

Edges = Literal["interp", "drop", "nearest", "mirror", "constant", "wrap"]


@dataclass(frozen=True)
class Smoother:
    """One Savitzky–Golay filter.

    Attributes
    ----------
    order : int
        Degree of the polynomials (k of the paper's tables, N in Table 3).
    frame : int
        Samples that each is fitted to, odd (f, F in Table 3).
    """

    order: int
    frame: int

    def __call__(self, signal: Array, edges: Edges, derivative: int = 0, step: float = 1.0) -> Array:
        """Smooth an evenly sampled signal, or differentiate it.

        Parameters
        ----------
        signal : (n,) array
            Samples.
        edges : str
            ``interp`` fits the last polynomial up to the edge, as MATLAB's `sgolayfilt` does; ``drop`` gives
            NaN for half a frame, which the example of MATLAB's `sgolay` leaves out; the others extend the
            signal.
        derivative : int
            Order of the derivative.
        step : float
            Sampling interval, s.
        """
        mode = "interp" if edges == "drop" else edges
        smooth = savgol_filter(signal, self.frame, self.order, deriv=derivative, delta=step, mode=mode)
        if edges == "drop":
            half = self.frame // 2
            smooth[:half] = smooth[-half:] = np.nan
        return np.asarray(smooth, dtype=float)

    def __str__(self) -> str:
        return f"({self.order}, {self.frame})"


@dataclass(frozen=True)
class Case:
    """One way to get velocity and acceleration from what was logged.

    Attributes
    ----------
    name : str
        Number in the paper.
    velocity : Smoother or None
        For the velocity.
    acceleration : tuple of Smoother
        For the acceleration, one after the other.
    differentiated : bool
        Whether the acceleration is the derivative of the velocity by its filter, not the one that was logged.
    source : str
        Where it is stated.
    """

    name: str
    velocity: Smoother | None
    acceleration: tuple[Smoother, ...]
    differentiated: bool
    source: str

    def needs(self, edges: Edges) -> int:
        """Samples without a gap that the filters need; with dropped edges each leaves the next one fewer."""
        first = [self.velocity] if self.velocity else []
        longest = max((f.frame for f in [*first, *self.acceleration]), default=2)
        chain = [*(first if self.differentiated else []), *self.acceleration]
        dropped = sum(f.frame - 1 for f in chain) + 1
        return max(longest, dropped) if edges == "drop" else longest

    def counts_samples(self, *, logged: bool) -> bool:
        """Whether an even clock matters: a filter, or differences where no acceleration was logged."""
        return self.velocity is not None or not logged

    def __str__(self) -> str:
        first = f"velocity {self.velocity}" if self.velocity else "nothing filtered"
        then = " then ".join(map(str, self.acceleration))
        parts = [first, *(["acceleration from it"] if self.differentiated else [])]
        return ", ".join([*parts, *([f"acceleration {then}"] if then else [])])

    def smoothed(
        self, velocity: Array, acceleration: Array | None, step: float, edges: Edges
    ) -> tuple[Array, Array]:
        """Velocity and acceleration of one motion after the filters, (n,) each.

        Parameters
        ----------
        velocity : (n,) array
            As logged, evenly sampled.
        acceleration : (n,) array or None
            As logged; central differences of the velocity where the log has none.
        step : float
            Sampling interval, s.
        edges : str
            What the filters do at the ends.
        """
        if self.differentiated:
            assert self.velocity is not None
            rate = self.velocity(velocity, edges, 1, step)
        else:
            rate = np.gradient(velocity, step) if acceleration is None else acceleration
        for smoother in self.acceleration:
            known = np.isfinite(rate)
            rate = rate.copy()
            rate[known] = smoother(rate[known], edges)
        return velocity if self.velocity is None else self.velocity(velocity, edges), rate


def _independent(number: int, *smoothers: Smoother, table: str) -> Case:
    """A case of Tables 1 and 2: velocity and acceleration are filtered each by itself."""
    return Case(str(number), smoothers[0], smoothers, False, f"paper, {table}")


_BOTH = {2: Smoother(1, 3), 3: Smoother(1, 5), 4: Smoother(1, 7), 5: Smoother(3, 7)}
_AGAIN = Smoother(1, 7)
_METHOD = Smoother(4, 11)
CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case("1", None, (), False, "paper, Table 1"),
        *(_independent(n, s, table="Table 1") for n, s in _BOTH.items()),
        *(_independent(n + 4, s, _AGAIN, table="Table 2") for n, s in _BOTH.items()),
        Case("10", _METHOD, (), True, "paper, Table 3"),
        Case("11", _METHOD, (_AGAIN,), True, "paper, Table 3"),
    )
}


def chosen_cases(words: str) -> list[Case]:
    """The cases that a list such as ``all`` or ``2,8,11`` names.

    Raises
    ------
    UndertowError
        If a name is no case.
    """
    if words == "all":
        return list(CASES.values())
    names = [word.strip() for word in words.split(",")]
    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise UndertowError(
            f"--cases {words}: {unknown[0]!r} is no case; give all, or some of {', '.join(CASES)}, "
            "as in 2,8,11"
        )
    return [CASES[name] for name in dict.fromkeys(names)]
