"""The memory of the water at the surface, as a small passive state-space model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares, nnls

from undertow.errors import UndertowError
from undertow.model.symbols import FORCE, VELOCITY
from undertow.typing import Array

from .floating import Afloat, Complex


@dataclass(frozen=True)
class MemoryRules:
    """When a fit is good enough."""

    good: float = 0.10  # error at which one state for each motion is enough, of the kernel, root mean square
    none: float = 1e-3  # share of the largest damping (turning: at half the length) that is no memory
    checked: int = 400  # frequencies at which the damping is looked at, a hundred times beyond both ends
    starts: tuple[float, ...] = (0.3, 1.0, 3.0)  # times in which memories fade, in periods of the peak


_RULES = MemoryRules()


@dataclass(frozen=True)
class Memory:
    """A model of the memory: one state for each motion, all of one time constant, or two for each motion.

    The force is minus `stiffness` times the first state; see the effects `radiation_memory` (order 1) and
    `wave_radiation` (order 2) for the states.
    """

    order: Literal[1, 2]
    stiffness: dict[int, float]  # by motion (0 to 5), N/m or N m/rad, positive
    time: dict[int, float]  # s
    frequency: dict[int, float]  # rad/s; none of order 1
    error: dict[int, float]  # root mean square of the residual of the kernel, as a share of it

    @property
    def effect(self) -> str:
        """Id of the effect that has these states."""
        return "radiation_memory" if self.order == 1 else "wave_radiation"

    @property
    def worst(self) -> float:
        """Largest error of all motions."""
        return max(self.error.values(), default=0.0)

    def kernel(self, i: int, omega: Array) -> Complex:
        """Force per velocity of a motion at frequencies (n,), rad/s."""
        return self.stiffness[i] * _shape(omega, self.time[i], self.frequency.get(i, 0.0))

    def parameters(self) -> Mapping[str, float]:
        """Parameters of the effect, SNAME signs."""
        if self.order == 1:
            own = {f"{FORCE[i]}_mem{VELOCITY[i]}": -k for i, k in self.stiffness.items()}
            return own | ({"T_memory": next(iter(self.time.values()))} if own else {})
        rows = [
            (
                (f"{FORCE[i]}_rad{VELOCITY[i]}", -k),
                (f"T_rad_{VELOCITY[i]}", self.time[i]),
                (f"omega_rad_{VELOCITY[i]}", self.frequency[i]),
            )
            for i, k in self.stiffness.items()
        ]
        return dict(pair for row in rows for pair in row)


def fit_memory(hull: Afloat, motions: Sequence[int], order: Literal[1, 2] | None = None) -> Memory:
    """The smallest of both models that is good enough, or that of an order; `motions`: 0 to 5.

    Raises `UndertowError` where a model feeds power into the hull at some frequency.
    """
    motions = [i for i in motions if _radiates(hull, i)]
    if order is None:
        first = fit_memory(hull, motions, 1)
        return first if first.worst <= _RULES.good else fit_memory(hull, motions, 2)
    found = _first_order(hull, motions) if order == 1 else _second_order(hull, motions)
    _check_passive(found, hull.omega)
    return found


def _shape(omega: Array, time: float, frequency: float) -> Complex:
    """Kernel for a stiffness of one: 1/(s + 1/T + w^2/s) at s = i omega."""
    s = 1j * omega
    return np.asarray(1 / (s + 1 / time + frequency**2 / s))


def _radiates(hull: Afloat, i: int) -> bool:
    """Whether a motion sends waves out that count: a body of revolution that spins sends none."""
    most = np.array([hull.damping[:, j, j].max() for j in range(3)]).max()
    arm = 1.0 if i < 3 else hull.length / 2
    return float(hull.damping[:, i, i].max()) > _RULES.none * float(most) * arm**2


def _error(wanted: Complex, found: Complex) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def _first_order(hull: Afloat, motions: Sequence[int]) -> Memory:
    """One time constant for all motions, the one that leaves least of all kernels."""
    kernels = {i: hull.kernel(i) for i in motions}

    def stiffness(time: float) -> dict[int, float]:
        shape = _shape(hull.omega, time, 0.0)
        table = np.concatenate([shape.real, shape.imag])[:, None]
        return {i: float(nnls(table, np.concatenate([k.real, k.imag]))[0][0]) for i, k in kernels.items()}

    def left(time: float) -> float:
        shape = _shape(hull.omega, time, 0.0)
        return sum(_error(kernels[i], k * shape) ** 2 for i, k in stiffness(time).items())

    times = np.geomspace(0.1 / hull.omega[-1], 10 / hull.omega[0], 200)
    best = float(min(times, key=left))
    shape, own = _shape(hull.omega, best, 0.0), stiffness(best)
    errors = {i: _error(kernels[i], k * shape) for i, k in own.items()}
    return Memory(1, own, dict.fromkeys(own, best), {}, errors)


def _second_order(hull: Afloat, motions: Sequence[int]) -> Memory:
    found = {i: _resonance(hull.omega, hull.kernel(i)) for i in motions}
    errors = {i: _error(hull.kernel(i), k * _shape(hull.omega, T, w)) for i, (k, T, w) in found.items()}
    k, T, w = ({i: row[j] for i, row in found.items()} for j in range(3))
    return Memory(2, k, T, w, errors)


def _resonance(omega: Array, kernel: Complex) -> tuple[float, float, float]:
    """Stiffness, time and frequency of the resonance nearest to a kernel; all positive, hence passive."""
    peak = float(omega[np.argmax(kernel.real)])
    height = float(kernel.real.max())

    def off(x: Array) -> Array:
        k, T, w = np.exp(x)
        rest = (k * _shape(omega, T, w) - kernel) / height
        return np.concatenate([rest.real, rest.imag])

    starts = [np.log([height / T, T, peak]) for T in np.array(_RULES.starts) * 2 * np.pi / peak]
    best = min((least_squares(off, x) for x in starts), key=lambda r: r.cost)
    k, T, w = np.exp(best.x)
    return float(k), float(T), float(w)


def _check_passive(memory: Memory, omega: Array) -> None:
    far = np.geomspace(omega[0] / 100, omega[-1] * 100, _RULES.checked)
    for i in memory.stiffness:
        least = float(memory.kernel(i, far).real.min())
        if not least >= 0:
            raise UndertowError(
                f"memory of {VELOCITY[i]}: damping {least:.3g} below 0 at some frequency: fit other motions"
            )
