"""What a real velocity sensor does to a log that is read as it should be, fitted to pose rates.

Each kind is linear in its parameters, so that one weighted least-squares solution tells how much of a
mismatch it would explain. A mistake is only believed where none of them explains the mismatch as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.typing import Array

from ..logs import Run
from ..logs.run import VELOCITY
from .kinematics import Kinematics, Mismatch, Rates, Samples, Stretch
from .mistake import SETTINGS

# Neighbouring test functions overlap, and what is left is no white noise: so many count as one.
_CLUSTER = 8
_ALIKE = {
    "velocity_misalignment": ("attitude_bias",),
    "velocity_lever_arm": ("position_lever_arm",),
}


@dataclass(frozen=True)
class Sensor:
    """One kind of deviation of velocity sensors.

    Attributes
    ----------
    id : str
        Id of the effect of the catalogue that describes it; "water" for velocities through the water.
    names : tuple of str
        Its parameters, with units.
    columns : callable
        From samples to the change of J(eta) nu that each parameter makes, (n, 6, k).
    largest : float
        Parameters beyond this are not believed.
    """

    id: str
    names: tuple[str, ...]
    columns: Callable[[Samples, Stretch], Array]
    largest: float = np.inf

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the catalogue that would leave the same mismatch."""
        return (self.id, *_ALIKE.get(self.id, ()))

    def parameters(self, value: Array) -> Array:
        """Parameters of the effect from what was fitted, a share of the reading in the case of a scale."""
        return value / (1.0 - value) if self.id == "sensor_scale" else value


@dataclass(frozen=True)
class SensorFit:
    """A sensor's deviation as fitted.

    Attributes
    ----------
    sensor : Sensor
        Which kind.
    value, error : (k,) arrays
        Its parameters and their standard errors.
    after : Mismatch
        What it leaves.
    """

    sensor: Sensor
    value: Array
    error: Array
    after: Mismatch

    @property
    def plausible(self) -> bool:
        """Whether the parameters are such as real sensors have."""
        return bool(np.all(np.abs(self.value) <= self.sensor.largest))

    def told(self) -> str:
        """Id and parameters."""
        parts = [
            f"{n.split(' ')[0]} = {v:.3g} ± {e:.1g} {' '.join(n.split(' ')[1:])}".rstrip()
            for n, v, e in zip(self.sensor.names, self.sensor.parameters(self.value), self.error, strict=True)
        ]
        return f"{self.sensor.id}: {', '.join(parts)}"


def sensors(kinematics: Kinematics) -> list[Sensor]:
    """All kinds that the channels of a comparison can show."""
    linear = [n for n in VELOCITY[:3] if n in kinematics.channels]
    angular = [n for n in VELOCITY[3:] if n in kinematics.channels]
    kinds = []
    if linear and kinematics.rows and kinematics.rows[0] in ("x", "y", "z"):
        kinds += _of_linear(linear, angular)
    if angular and kinematics.rows[-1] in ("phi", "theta", "psi"):
        kinds.append(
            Sensor("sensor_bias", tuple(f"b_{n} rad/s" for n in angular), _chosen(_bias, angular), 0.2)
        )
        kinds.append(Sensor("sensor_scale", tuple(f"s_{n}" for n in angular), _chosen(_scale, angular), 0.5))
    return kinds


def _of_linear(linear: list[str], angular: list[str]) -> list[Sensor]:
    found = [
        Sensor("sensor_bias", tuple(f"b_{n} m/s" for n in linear), _chosen(_bias, linear)),
        # A Doppler log set for another speed of sound is some percent off; knots are half of what they say.
        Sensor("sensor_scale", ("s",), _common_scale, SETTINGS.scale),
        Sensor("sensor_delay", ("delay s",), _late, 3.0),
        Sensor("water", ("north m/s", "east m/s", "down m/s")[: 3 if "w" in linear else 2], _water(linear)),
    ]
    if "u" in linear and "v" in linear:
        found.append(Sensor("velocity_misalignment", ("alpha rad",), _turned, 0.5))
    arms = {"x_s": "r" in angular or "q" in angular, "y_s": "r" in angular or "p" in angular}
    arms["z_s"] = "p" in angular or "q" in angular
    names = [n for n, seen in arms.items() if seen]
    if names:
        places = ["xyz".index(n[0]) for n in names]
        found.append(Sensor("velocity_lever_arm", tuple(f"{n} m" for n in names), _arm(places), 5.0))
    return found


# --- columns ----------------------------------------------------------------------------------
def _chosen(columns: Callable[[Samples], Array], names: Sequence[str]) -> Callable[[Samples, Stretch], Array]:
    places = [VELOCITY.index(n) for n in names]
    return lambda at, _: columns(at)[:, :, places]


def _bias(at: Samples) -> Array:
    """A reading that is too large by a constant: what is there is smaller."""
    return -at.jacobian


def _scale(at: Samples) -> Array:
    return -at.jacobian * at.velocity[:, None, :]


def _common_scale(at: Samples, _: Stretch) -> Array:
    return _scale(at)[:, :, :3].sum(axis=2, keepdims=True)


def _late(at: Samples, s: Stretch) -> Array:
    """Velocities of a while ago: the change of J nu is the delay times J d(nu)/dt."""
    change = np.gradient(at.velocity[:, :3], s.times, axis=0)
    return np.einsum("nij,nj->ni", at.jacobian[:, :, :3], change)[:, :, None]


def _turned(at: Samples, _: Stretch) -> Array:
    """A sensor turned by alpha reads (u + alpha v, v - alpha u)."""
    u, v = at.velocity[:, 0], at.velocity[:, 1]
    real = np.stack([-v, u, np.zeros_like(u)], axis=1)
    return np.einsum("nij,nj->ni", at.jacobian[:, :, :3], real)[:, :, None]


def _arm(places: list[int]) -> Callable[[Samples, Stretch], Array]:
    """A sensor at r_s reads v + omega x r_s."""

    def columns(at: Samples, _: Stretch) -> Array:
        omega = at.velocity[:, 3:]
        crossed = np.stack([np.cross(omega, np.eye(3)[i]) for i in places], axis=2)
        return -np.einsum("nij,njk->nik", at.jacobian[:, :, :3], crossed)

    return columns


def _water(linear: list[str]) -> Callable[[Samples, Stretch], Array]:
    size = 3 if "w" in linear else 2
    return lambda at, _: np.broadcast_to(np.eye(6)[:, :size], (len(at.pose), 6, size))


# --- fit --------------------------------------------------------------------------------------
def fit_sensor(kinematics: Kinematics, runs: Sequence[Run], rates: Rates, sensor: Sensor) -> SensorFit:
    """Fit one kind of deviation to what pose rates and velocities differ by."""
    regressor = regressor_of(kinematics, runs, sensor)
    weight = 1.0 / np.sqrt(rates.variance + 1e-12 * np.mean(rates.pose**2 + rates.velocity**2, axis=0))
    table = (regressor * weight[:, :, None]).reshape(-1, regressor.shape[2])
    target = ((rates.pose - rates.velocity) * weight).ravel()
    value, error = clustered_least_squares(table, target, _CLUSTER * len(kinematics.rows))
    fitted = Rates(rates.pose, rates.velocity + regressor @ value, rates.variance)
    return SensorFit(sensor, value, error, kinematics.of_rates(fitted))


def regressor_of(kinematics: Kinematics, runs: Sequence[Run], sensor: Sensor) -> Array:
    """Change of J(eta) nu that each parameter makes, as means over test functions, (K, rows, k)."""
    return np.concatenate([_tested(kinematics, runs[s.run], s, sensor) for s in kinematics.stretches])


def _tested(kinematics: Kinematics, run: Run, s: Stretch, sensor: Sensor) -> Array:
    """Mean of the columns over every test function, (K, rows, k)."""
    columns = sensor.columns(kinematics.samples(run, s), s)[:, kinematics.places]
    flat = s.functions.value @ columns.reshape(len(columns), -1)
    return np.asarray(flat).reshape(-1, *columns.shape[1:]) / s.length[:, None, None]


def clustered_least_squares(
    table: Array, target: Array, size: int, rcond: float = 1e-10
) -> tuple[Array, Array]:
    """Least squares with standard errors from clusters of `size` neighbouring rows (sandwich estimator).

    Rows are in units of their noise; errors are never less than independent rows of that noise would give,
    since few clusters say little. Combinations of columns whose share of the whole is below `rcond` (squared)
    are left at zero.
    """
    scale = np.linalg.norm(table, axis=0)
    seen = scale > 0
    value, error = np.zeros(len(scale)), np.full(len(scale), np.inf)
    scaled = table[:, seen] / scale[seen]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=rcond, hermitian=True)
    solution = inverse @ (scaled.T @ target)
    left = target - scaled @ solution
    scores = scaled * left[:, None]
    groups = np.add.reduceat(scores, np.arange(0, len(scores), size), axis=0)
    value[seen] = solution / scale[seen]
    plain = max(1.0, float(left @ left) / max(len(left) - len(solution), 1)) * np.diag(inverse)
    clustered = np.diag(inverse @ (groups.T @ groups) @ inverse)
    error[seen] = np.sqrt(np.maximum(plain, clustered)) / scale[seen]
    return value, error
