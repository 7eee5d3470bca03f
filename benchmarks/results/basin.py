"""Towing and bollard tests of C/S Enterprise I, and what a model says about the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import polars as pl
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Basin:
    """Measured forces, as functions of speed (towing) and set-point (bollard): columns of (value, N)."""

    surge: Array
    sway: Array
    vsp_surge: Array
    vsp_sway: Array
    bow: Array

    @classmethod
    def read(cls, folder: Path) -> Basin:
        """From the folders `towing` and `bollard`."""
        towing, bollard = folder / "towing", folder / "bollard"
        total = ("setpoint", "force_total_N")
        return cls(
            _columns(towing / "surge_runs.csv", "u_mps", "X_hydro_N"),
            _columns(towing / "sway_runs.csv", "v_nominal_mps", "Y_hydro_N"),
            _columns(bollard / "vsp_surge_both_propellers.csv", *total),
            _columns(bollard / "vsp_sway_port_u2.csv", *total),
            _columns(bollard / "bow_thruster_u5.csv", *total),
        )


def _columns(path: Path, value: str, force: str) -> Array:
    table = pl.read_csv(path).select(value, force).sort(value)
    return np.asarray(table.to_numpy(), dtype=float)


def at(table: Array, values: Array) -> Array:
    """Measured force, linear between the test points."""
    return np.asarray(np.interp(values, table[:, 0], table[:, 1]))


def drag(vehicle: Vehicle, axis: str, speeds: Array) -> Array:
    """Steady force of all damping effects in direction u or v at these speeds of that direction alone, N."""
    f = Functions(vehicle)
    place = vehicle.velocity_names.index(axis)
    chosen = [e.id for e in vehicle.effects if e.family == "damping"]
    force = sum((f.wrenches[i][place] for i in chosen), ca.SX(0))
    still = [ca.DM.zeros(s.shape) for s in (f.eta, f.nu_dot, f.memory, f.actuation, f.u, f.t)]
    steady = ca.Function("drag", [f.eta, f.nu_dot, f.memory, f.actuation, f.u, f.t, f.nu, f.p], [force])
    velocity = np.zeros((len(vehicle.velocity_names), len(speeds)))
    velocity[place] = speeds
    return np.array([float(steady(*still, v, f.values())) for v in velocity.T])


def thrust(vehicle: Vehicle, names: tuple[str, ...], setpoints: Array) -> Array:
    """Steady thrust of several thrusters at a common set-point, at zero speed, N."""
    f = Functions(vehicle)
    steady = f.actuator_output
    if f.actuator_states.numel():
        steady = ca.substitute(steady, f.actuator_states, f.actuator_rest)
    # Every thruster has its own line of action: what counts here is the sum of their thrusts.
    per_command = [vehicle.value_of(f"thrust_{t.name}").value for t in vehicle.thrusters]
    output = ca.Function("thrust", [f.u, f.p], [steady])
    chosen = [i for i, t in enumerate(vehicle.thrusters) if t.name in names]
    forces = []
    for c in setpoints:
        command = np.zeros(f.u.numel())
        command[chosen] = c
        forces.append(sum(float(output(command, f.values())[i]) * per_command[i] for i in chosen))
    return np.array(forces)


def dead_band(table: Array, least: float = 0.3) -> tuple[float, float]:
    """Slope (N per set-point) and dead band of a bollard curve, by a line through the larger set-points."""
    positive = table[(table[:, 0] >= least) & (table[:, 0] <= 0.9)]
    slope, offset = np.polyfit(positive[:, 0], positive[:, 1], 1)
    return float(slope), float(-offset / slope)
