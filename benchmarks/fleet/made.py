"""Logs of a small craft whose parameters drift from day to day, by the project's own simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl

from undertow.codegen import Functions, Simulator
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle

CRAFT = """\
schema = "undertow/vehicle/1"
name = "craft"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"

[effects.rigid_body]
m = 20.0
x_g = 0.0
y_g = 0.0
I_z = 1.6

[effects.rigid_body_coriolis]

[effects.added_mass]
X_udot = { value = -3.0, estimate = true, sigma = 0.5 }
Y_vdot = { value = -12.0, estimate = true, sigma = 2.0 }
N_rdot = { value = -0.6, estimate = true, sigma = 0.1 }

[effects.added_mass_coriolis]

[effects.linear_damping]
X_u = { value = -3.0, estimate = true, sigma = 0.5 }
Y_v = { value = -9.0, estimate = true, sigma = 1.5 }
N_r = { value = -0.5, estimate = true, sigma = 0.1 }

[effects.quadratic_damping]
X_uabsu = { value = -8.0, estimate = true, sigma = 1.5 }

[[thrusters]]
name = "port"
wrench = [1.0, 0.0, 0.0, 0.0, 0.0, 0.2]

[[thrusters]]
name = "starboard"
wrench = [1.0, 0.0, 0.0, 0.0, 0.0, -0.2]

[[thrusters]]
name = "bow"
wrench = [0.0, 1.0, 0.0, 0.0, 0.0, 0.1]
"""
DRAG = ("X_u", "Y_v", "N_r", "X_uabsu")
CHANNELS = ("x", "y", "psi", "u", "v", "r")
THRUSTERS = ("port", "starboard", "bow")
_NOISE = np.array([0.02, 0.02, 0.003, 0.01, 0.01, 0.002])
_RATE, _HELD = 10, 20
# What the truth may have more than the model of the craft.
_MORE = ("thruster_gain", "ocean_current", "entrained_water", "sensor_scale")


def days(months: int = 3, each: int = 3) -> list[date]:
    """Some days at the beginning of each month."""
    return [date(2026, 1 + m, 2) + timedelta(days=2 * i) for m in range(months) for i in range(each)]


def folder_with_vehicle(folder: Path) -> Path:
    """The file of the craft."""
    path = folder / "craft.toml"
    path.write_text(CRAFT)
    return path


@cache
def _plant(path: Path) -> tuple[Functions, Simulator]:
    vehicle = load_vehicle(path)
    for effect in _MORE:
        vehicle = vehicle.with_effect(catalogue()[effect], {})
    functions = Functions(vehicle)
    return functions, Simulator(functions)


def log(
    path: Path,
    drift: Mapping[str, float],
    random: np.random.Generator,
    current: float = 0.05,
    seconds: int = 50,
) -> dict[str, np.ndarray]:
    """Columns of one day's log.

    Parameters
    ----------
    path : Path
        The vehicle file.
    drift : mapping
        Relative change of coefficients that the file has; values of those that only the truth has.
    random : Generator
        Of the commands, the noise, and a current that differs from day to day.
    current : float
        Standard deviation of that, m/s.
    seconds : int
        Length, at 10 Hz.
    """
    functions, simulator = _plant(path)
    names, p = functions.parameter_names, np.array(functions.values(), dtype=float)
    for name, change in drift.items():
        place = names.index(name)
        p[place] = p[place] * (1 + change) if p[place] else change
    p[[names.index("V_N"), names.index("V_E")]] = current * random.standard_normal(2)
    t = np.arange(seconds * _RATE + 1) / _RATE
    u = np.repeat(random.uniform(-8, 8, (len(t) // _HELD + 1, 3)), _HELD, axis=0)[: len(t)]
    start = np.zeros(6)
    start[2] = random.uniform(-3, 3)
    motion = simulator.run(start, t, u, p)
    motion[:, 3:5] *= 1 + p[names.index("scale_velocity")]
    reported = motion + _NOISE * random.standard_normal(motion.shape)
    return {"t": t, **dict(zip(CHANNELS, reported.T, strict=True)), **dict(zip(THRUSTERS, u.T, strict=True))}


def run(path: Path, drift: Mapping[str, float], random: np.random.Generator) -> Run:
    """The same as a run."""
    columns = log(path, drift, random)
    return Run("day", columns.pop("t"), columns)


def fouling(share: float) -> dict[str, float]:
    """All drag grown by a share."""
    return dict.fromkeys(DRAG, share)


def write(
    folder: Path,
    path: Path,
    vehicle: str,
    drifts: Sequence[tuple[date, Mapping[str, float]]],
    seconds: int = 50,
) -> None:
    """Logs of one vehicle as `vehicle=V/day=D/part.parquet`."""
    for day, drift in drifts:
        target = folder / f"vehicle={vehicle}" / f"day={day}"
        target.mkdir(parents=True)
        random = np.random.default_rng([day.toordinal(), len(vehicle), ord(vehicle[0])])
        columns = log(path, drift, random, seconds=seconds)
        pl.DataFrame(columns).write_parquet(target / "part.parquet")
