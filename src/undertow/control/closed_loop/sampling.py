"""How long a sampling interval may be: from the eigenvalues of the sampled loop, and of the law's jumps."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.linalg import expm

from undertow.errors import UndertowError

from .parts import Parts
from .scenario import MOST_SAMPLES

# Growth that counts as none, 1/s: rounding splits poles at zero (a cross-track error that nothing corrects).
_STILL = 1e-4
_SHORTEST, _LONGEST = 1e-4, 1e3
# Both sets of parameters that differ by direction are looked at: this far to either side of rest.
_CREEP = 1e-9
# Longest Runge-Kutta step: s, and as a part of the fastest time constant (right to 0.1 % of its decay).
_STEP, _REACH = 0.05, 0.5


class SampledLoop:
    """A closed loop linearised at its set-point, at rest.

    What has a jump there counts as constant, as the sign of a sliding-mode law does; dead times are left out.
    The vehicle is looked at with either set of parameters that differ by direction, the law with their mean.
    """

    def __init__(self, parts: Parts, pose: np.ndarray, desired: np.ndarray) -> None:
        self._parts, self._desired = parts, desired
        self._sides = [self._linear(pose, side) for side in (1, -1)]

    def _linear(self, pose: np.ndarray, side: int) -> tuple[np.ndarray, ...]:
        """A and B of the vehicle, Ky, Ks of the commands, Ry, Rs of the law's rates, C of the reports."""
        parts = self._parts
        states = np.array(parts.controller.initial_states())
        states[-1] = 1.0
        # The law at rest: beside it, the slope of a root would be that of nowhere else.
        y = np.concatenate([pose, np.zeros(len(pose))])
        u = np.asarray(parts.law(y, self._desired, states, parts.gains)[0]).ravel()
        x = parts.at_rest(pose, u, np.full(len(pose), side * _CREEP))
        a, b = _jacobians(parts.dynamics, ("x", "u"), "x_dot", (x, u, parts.parameters, 0.0))
        (c,) = _jacobians(parts.outputs, ("x",), "y", (x, u, parts.parameters, 0.0))
        point = (y, self._desired, states, parts.gains)
        by_u = _jacobians(parts.law, ("y", "s"), "u", point)
        by_rate = _jacobians(parts.law, ("y", "s"), "s_dot", point)
        return a, b, *by_u, *by_rate, c

    # --- eigenvalues --------------------------------------------------------------------------
    def continuous_rates(self, side: int = 0) -> np.ndarray:
        """Eigenvalues without sampling, 1/s."""
        a, b, ky, ks, ry, rs, c = self._sides[side]
        return np.linalg.eigvals(np.block([[a + b @ ky @ c, b @ ks], [ry @ c, rs]]))

    def sampled_rates(self, dt: float, side: int = 0) -> np.ndarray:
        """Logarithms of the eigenvalues from sample to sample, divided by dt, 1/s."""
        a, b, ky, ks, ry, rs, c = self._sides[side]
        n, m = b.shape
        held = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * dt)
        ad, bd = held[:n, :n], held[:n, n:]
        step = np.block([[ad + bd @ ky @ c, bd @ ks], [dt * ry @ c, np.eye(len(rs)) + dt * rs]])
        with np.errstate(divide="ignore"):
            return np.log(np.linalg.eigvals(step).astype(complex)) / dt

    def keeps_stability(self, dt: float) -> bool:
        """Whether sampling makes nothing unstable that is stable without it."""
        return all(
            _growing(self.sampled_rates(dt, side)) <= _growing(self.continuous_rates(side)) for side in (0, 1)
        )

    def longest(self) -> float:
        """The interval up to which sampling makes nothing unstable, s; infinite where there is none."""
        grid = np.geomspace(_SHORTEST, _LONGEST, 141)
        bad = next((i for i, dt in enumerate(grid) if not self.keeps_stability(float(dt))), None)
        if bad is None:
            return np.inf
        low, high = (float(grid[bad - 1]), float(grid[bad])) if bad else (0.0, _SHORTEST)
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.keeps_stability(middle) else (low, middle)
        return low

    def substeps(self, dt: float, continuous: bool = False) -> int:
        """Runge-Kutta steps in an interval, so that each is short beside the fastest motion.

        That is one of the vehicle, as its commands are held, and of the whole loop where they are not.
        """
        longest = min(_STEP, _REACH / self.fastest(continuous))
        return max(int(np.ceil(dt / longest - 1e-9)), 1)

    def fastest(self, continuous: bool) -> float:
        """Magnitude of the fastest eigenvalue of the vehicle, or of the loop without sampling, 1/s."""
        own = [np.linalg.eigvals(side[0]) for side in self._sides]
        rates = [self.continuous_rates(side) for side in (0, 1)] if continuous else own
        return max(float(np.abs(np.concatenate(rates)).max(initial=0.0)), _REACH / _STEP)


def _growing(rates: np.ndarray) -> int:
    return int((rates.real > _STILL).sum())


def _jacobians(function: ca.Function, by: tuple[str, ...], of: str, point: tuple) -> list[np.ndarray]:
    """Derivatives of one output at a point; what is not finite there (the root of a sign) counts as zero."""
    symbols = [ca.SX.sym(n, function.size1_in(n)) for n in function.name_in()]
    output = function(*symbols)
    value = (output if isinstance(output, tuple) else (output,))[function.name_out().index(of)]
    wanted = [symbols[function.name_in().index(n)] for n in by]
    found = ca.Function("slopes", symbols, [ca.densify(ca.jacobian(value, v)) for v in wanted]).call(
        list(point)
    )
    return [np.nan_to_num(np.asarray(m), nan=0.0, posinf=0.0, neginf=0.0) for m in found]


# --- refusing ----------------------------------------------------------------------------------
def offsets(parts: Parts, dt: float) -> dict[str, float]:
    """Estimate of the distance from the set-point that a sampled jump may leave, m and rad, by coordinate."""
    gains = parts.controller.gains
    rows = gains.law.offset(gains.signals).xreplace(gains.numbers)
    names = gains.plant.vehicle.pose_names
    power = dt**gains.law.offset_order
    return {name: float(row) * power for name, row in zip(names, rows, strict=True) if row}


def check_interval(loop: SampledLoop, parts: Parts, dt: float, moves: dict[str, float]) -> None:
    """Refuse a sampling interval that is too long for the law."""
    name, order = parts.controller.gains.name, parts.controller.gains.law.offset_order
    if not loop.keeps_stability(dt):
        raise UndertowError(
            f"dt = {dt:g} s is too long for '{name}' on '{parts.vehicle.name}': sampled so slowly, what is "
            f"stable in continuous time becomes unstable; the limit is {loop.longest():.3g} s"
        )
    for coordinate, left in offsets(parts, dt).items():
        move = abs(moves[coordinate])
        if 0 < move <= left:
            raise UndertowError(
                f"dt = {dt:g} s is too long for '{name}': the sign of its surface, sampled, by "
                f"estimate may leave {left:.3g} in {coordinate}, where {move:.3g} is to be gone; it must be "
                f"below {dt * (move / left) ** (1 / order):.3g} s"
            )


def check_steps(loop: SampledLoop, parts: Parts, dt: float, samples: int) -> None:
    """Refuse a loop that cannot be integrated without sampling."""
    if any(parts.late[1]) or parts.late[0]:
        raise UndertowError("dead times need a sampled law, but it is not sampled: leave --continuous out")
    steps = float(samples) * loop.substeps(dt, continuous=True)
    if steps > MOST_SAMPLES:
        raise UndertowError(
            f"'{parts.controller.gains.name}' on '{parts.vehicle.name}' is as fast as "
            f"{loop.fastest(continuous=True):.3g} 1/s: without sampling that takes {steps:.3g} steps, and "
            f"{MOST_SAMPLES:.0e} are the most; shorten the run, or leave --continuous out"
        )
