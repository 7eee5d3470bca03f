"""The equations of a steady motion, and their solution."""

from __future__ import annotations

import numpy as np

from undertow.errors import UndertowError
from undertow.model.symbols import POSE, VELOCITY
from undertow.typing import Array

from .numeric import Numeric
from .request import Request

# Price of what is found: drift is avoided before tilt, and tilt before command.
_DRIFT, _TILT, _COMMAND, _OWN = 1e2, 1.0, 1e-4, 1e-6
_HEADINGS = np.radians([0.0, 90.0, 180.0, -90.0])
_BALANCED = 1e-9
_ROUNDS, _HALVINGS = 12, 12
# Drift and tilt below this are put to zero where commands can do so: m/s, rad/s and rad.
_NEXT_TO_NOTHING = 5e-3


class Balance:
    """Equations F(y) = 0 of a steady motion in the unknowns y among states and commands.

    Parameters
    ----------
    numeric : Numeric
        The vehicle.
    wanted : Request
        What is held.
    """

    def __init__(self, numeric: Numeric, wanted: Request) -> None:
        self.numeric, self.wanted = numeric, wanted
        self.names = (*numeric.states, *numeric.commands)
        self.unknown = [i for i, name in enumerate(self.names) if name not in wanted.held]
        self._rows = [i for i, name in enumerate(numeric.states) if self._is_steady(name)]
        self.start = np.array([wanted.held.get(name, 0.0) for name in self.names])

    def _is_steady(self, name: str) -> bool:
        """Heading and place may go on changing; velocities and all else may not."""
        return name not in ("x", "y", "psi") and not (name == "z" and self.wanted.climbs)

    @property
    def rows(self) -> list[str]:
        """Names of the states that are to be steady."""
        return [self.numeric.states[i] for i in self._rows]

    @property
    def prices(self) -> Array:
        """Price of the square of each unknown."""
        return np.array([self._price(self.names[i]) for i in self.unknown])

    def _price(self, name: str) -> float:
        if name in self.numeric.commands:
            return _COMMAND
        return _DRIFT if name in VELOCITY else _TILT if name in POSE else _OWN

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Limits of each unknown: what thrusters can give."""
        limits = {t.name: t.limit for t in self.numeric.vehicle.thrusters}
        most = [limits.get(self.names[i]) for i in self.unknown]
        return [(None, None) if m is None else (-m, m) for m in most]

    def split(self, y: Array) -> tuple[Array, Array]:
        """State and commands for values of the unknowns."""
        every = self.start.copy()
        every[self.unknown] = y
        n = len(self.numeric.states)
        return every[:n], every[n:]

    def __call__(self, y: Array) -> Array:
        return self.numeric.rate(0.0, *self.split(y))[self._rows]

    def slope(self, y: Array) -> Array:
        """dF/dy."""
        _, a, b, _ = self.numeric.slopes(*self.split(y))
        return np.hstack([a, b])[np.ix_(self._rows, self.unknown)]


def solve(balance: Balance, commands: Array | None = None) -> tuple[Array, Array]:
    """State and commands of the cheapest steady motion.

    Parameters
    ----------
    balance : Balance
        The equations.
    commands : ndarray, shape (nu,), optional
        Where the search begins.

    Raises
    ------
    UndertowError
        If there is none, or none within the limits of the commands.
    """
    found = [_from(balance, y) for y in _starts(balance, commands)]
    good = [y for y in found if _size(balance, y) < _BALANCED]
    if not good:
        raise UndertowError(_reason(balance, min(found, key=lambda y: _size(balance, y))))
    inside = [y for y in good if not _beyond(balance, y)]
    if not inside:
        raise UndertowError(_beyond(balance, good[0]))
    best = min(inside, key=lambda y: float(balance.prices @ y**2))
    return _tidied(balance, best)


def _tidied(balance: Balance, y: Array) -> tuple[Array, Array]:
    """The motion with no drift and no tilt at all where they are next to nothing."""
    names = [balance.names[i] for i in balance.unknown]
    faint = [n for n, v in zip(names, y, strict=True) if abs(v) < _NEXT_TO_NOTHING]
    small = [n for n in faint if n in (*POSE, *VELOCITY)]
    upright = Balance(balance.numeric, balance.wanted.also(dict.fromkeys(small, 0.0)))
    start = np.array([v for n, v in zip(names, y, strict=True) if n not in small])
    again = _polished(upright, start)
    fine = _size(upright, again) < _BALANCED and not _beyond(upright, again)
    return upright.split(again) if fine else balance.split(y)


def _starts(balance: Balance, commands: Array | None = None) -> list[Array]:
    """Where the search begins: at rest, with several headings where the heading is to be found."""
    places = {balance.names[i]: k for k, i in enumerate(balance.unknown)}
    begin = np.zeros(len(places))
    for name, value in zip(balance.numeric.commands, () if commands is None else commands, strict=False):
        if name in places:
            begin[places[name]] = value
    if "psi" not in places:
        return [begin]
    turns = np.tile(begin, (len(_HEADINGS), 1))
    turns[:, places["psi"]] = _HEADINGS
    return list(turns)


def _from(balance: Balance, y: Array) -> Array:
    if not y.size:  # everything is held: SLSQP does not take a search without unknowns
        return y
    from scipy.optimize import minimize

    prices = balance.prices
    done = minimize(
        lambda y: 0.5 * float(prices @ y**2),
        y,
        jac=lambda y: prices * y,
        method="SLSQP",
        bounds=balance.bounds(),
        constraints={"type": "eq", "fun": balance, "jac": balance.slope},
        options={"maxiter": 300, "ftol": 1e-14},
    )
    return _polished(balance, done.x)


def _polished(balance: Balance, y: Array) -> Array:
    """The last digits: Newton's steps onto F = 0, then along it to the least price."""
    for _ in range(_ROUNDS):
        y = _nearer(balance, y)
    for _ in range(_ROUNDS):
        inverse, target, scale = _local(balance, y)
        wanted = scale * (inverse @ (target - balance(y)))
        if not _size(balance, wanted) < _BALANCED / 10:
            break
        y = wanted
    return y


def _local(balance: Balance, y: Array) -> tuple[Array, Array, Array]:
    """Inverse of the slope in unknowns divided by their scale, slope times y, and the scale."""
    scale: Array = 1 / np.sqrt(balance.prices)
    slope: Array = np.nan_to_num(balance.slope(y)) * scale
    inverse = np.asarray(np.linalg.pinv(slope, rcond=1e-10), dtype=float)
    return inverse, slope @ (y / scale), scale


def _nearer(balance: Balance, y: Array) -> Array:
    """One step of Newton's, halved until it brings the motion nearer to a steady one."""
    before = _size(balance, y)
    inverse, _, scale = _local(balance, y)
    step = -scale * (inverse @ balance(y))
    tries = (y + step / 2**k for k in range(_HALVINGS))
    return next((t for t in tries if _size(balance, t) < before), y)


def _size(balance: Balance, y: Array) -> float:
    """How far a motion is from steady; endless where numbers fail."""
    largest = float(np.max(np.abs(balance(y)), initial=0.0))
    return largest if np.isfinite(largest) else float("inf")


# --- why there is none ----------------------------------------------------------------------------
def _reason(balance: Balance, y: Array) -> str:
    if any(m != (None, None) for m in balance.bounds()):
        loose = _Unlimited(balance.numeric, balance.wanted)
        far = [y for y in (_from(loose, s) for s in _starts(loose)) if _size(loose, y) < _BALANCED]
        if far:
            return _beyond(balance, far[0])
    value = np.abs(balance(y))
    worst = balance.rows[int(np.argmax(value))]
    held = balance.wanted.given
    return (
        f"no steady motion of '{balance.numeric.vehicle.name}' has these values: {worst} keeps changing by "
        f"{value.max():.3g} (SI) a second, whatever the commands; let go of one of {', '.join(held)}"
    )


class _Unlimited(Balance):
    """The same with thrusters as strong as need be."""

    def bounds(self) -> list[tuple[float | None, float | None]]:
        return [(None, None)] * len(self.unknown)


def _beyond(balance: Balance, y: Array) -> str:
    """What a command would have to be, if that is more than it can."""
    for i, value, (_, most) in zip(balance.unknown, y, balance.bounds(), strict=True):
        if most is not None and abs(value) > most * (1 + 1e-9):
            return (
                f"this steady motion takes {balance.names[i]} = {value:.4g}, and its limit is {most:g}: ask "
                "for less speed, or state a stronger thruster"
            )
    return ""


def at_parameters(balance: Balance, p: Array, x: Array, u: Array) -> tuple[Array, Array] | None:
    """The trim near a known one for other values of the parameters, or None where there is none."""
    changed = _Changed(balance, p)
    y = _polished(changed, np.concatenate([x, u])[balance.unknown])
    return changed.split(y) if _size(changed, y) < _BALANCED else None


class _Changed(Balance):
    """The same motion of a vehicle with other parameters."""

    def __init__(self, balance: Balance, p: Array) -> None:
        super().__init__(balance.numeric, balance.wanted)
        self._p = p

    def __call__(self, y: Array) -> Array:
        return self.numeric.rate(0.0, *self.split(y), self._p)[self._rows]

    def slope(self, y: Array) -> Array:
        _, a, b, _ = self.numeric.slopes(*self.split(y), self._p)
        return np.hstack([a, b])[np.ix_(self._rows, self.unknown)]
