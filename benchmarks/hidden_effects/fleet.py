"""The vehicles of the benchmark as drawn: one, three, four and six degrees of freedom."""

from __future__ import annotations

import numpy as np

from .drawing import Vehicle, rotor_column


def _mini_auv() -> Vehicle:
    """A small AUV with two vertical (f1, f3) and two forward (f2, f4) thrusters; sway has none."""
    arm = 0.16
    columns = [rotor_column((0, -arm, 0), (0, 0, 1)), rotor_column((0, -arm, 0), (1, 0, 0)),
               rotor_column((0, arm, 0), (0, 0, 1)), rotor_column((0, arm, 0), (1, 0, 0))]  # fmt: skip
    allocation = np.column_stack(columns)
    allocation[[1, 3, 4]] = 0.0  # roll and pitch are held by the hull's stiffness and are not modelled
    return Vehicle(
        name="mini-auv", dofs=(0, 1, 2, 5), mass=7.5,
        inertia=np.array([0.11, 0.199, 0.251]), r_g=np.zeros(3), r_b=np.zeros(3),
        added=-np.array([1.63, 3.3, 2.6, 0, 0, 0.0237]),
        linear=-np.array([0.55, 2.7, 6.2, 0, 0, 0.065]),
        quadratic=-np.array([5.3, 0, 0, 0, 0, 0]),
        allocation=allocation, command_limit=6.0, depth=8.0,
        reach=np.array([2.4, 0, 2.0, 0, 0, 0.15]), pace=np.array([0.45, 0.2, 0.2, 0.1, 0.1, 0.7]),
        length=0.6, tether=np.array([-0.25, 0.0, 0.0]),
    )  # fmt: skip


def _rov() -> Vehicle:
    """An open-frame ROV with four horizontal thrusters at 45 degrees (f1-f4) and four vertical (f5-f8)."""
    diagonal = float(np.sqrt(0.5))
    flat = [rotor_column((0.156, s * 0.111, 0.0), (diagonal, -s * diagonal, 0)) for s in (1, -1)]
    flat += [rotor_column((-0.156, s * 0.111, 0.0), (diagonal, s * diagonal, 0)) for s in (1, -1)]
    upright = [rotor_column((x, y, 0), (0, 0, -1)) for x in (0.12, -0.12) for y in (0.218, -0.218)]
    return Vehicle(
        name="rov", dofs=(0, 1, 2, 3, 4, 5), mass=11.5,
        inertia=np.array([0.20, 0.21, 0.19]), r_g=np.array([0.0, 0.0, 0.06]), r_b=np.zeros(3),
        added=-np.array([5.5, 12.7, 14.57, 0.12, 0.12, 0.12]),
        linear=-np.array([4.03, 6.22, 5.18, 0.07, 0.07, 0.07]),
        quadratic=-np.array([18.18, 21.66, 36.99, 1.55, 1.55, 1.55]),
        allocation=np.column_stack(flat + upright), command_limit=12.0, depth=10.0,
        reach=np.array([16.0, 16.0, 14.0, 1.2, 1.2, 1.8]), pace=np.array([0.45, 0.45, 0.35, 0.3, 0.3, 0.7]),
        length=0.5, tether=np.array([-0.15, 0.0, -0.1]),
    )  # fmt: skip


def _usv() -> Vehicle:
    """A model ship: surge force (f1), bow force 0.35 m ahead of the origin (f2), yaw moment (f3)."""
    columns = [rotor_column((0, 0, 0), (1, 0, 0)), rotor_column((0.35, 0, 0), (0, 1, 0)), np.eye(6)[5]]
    return Vehicle(
        name="usv", dofs=(0, 1, 5), mass=23.8,
        inertia=np.array([1.0, 1.0, 1.76]), r_g=np.array([0.046, 0.0, 0.0]), r_b=np.array([0.046, 0.0, 0.0]),
        added=-np.array([2.0, 10.0, 0, 0, 0, 1.0]),
        linear=-np.array([0.72, 0.89, 0, 0, 0, 1.9]),
        quadratic=-np.array([1.33, 36.5, 0, 0, 0, 0.75]),
        allocation=np.column_stack(columns), command_limit=2.0, depth=0.0,
        reach=np.array([1.6, 1.2, 0, 0, 0, 0.6]), pace=np.array([0.35, 0.12, 0.1, 0.1, 0.1, 0.2]),
        length=1.25, tether=np.zeros(3),
    )  # fmt: skip


def _box() -> Vehicle:
    """A box hull on a straight course, two thrusters side by side."""
    return Vehicle(
        name="box", dofs=(0,), mass=24.0, inertia=np.ones(3), r_g=np.zeros(3), r_b=np.zeros(3),
        added=-np.array([20.0, 0, 0, 0, 0, 0]), linear=-np.array([6.0, 0, 0, 0, 0, 0]),
        quadratic=-np.array([45.0, 0, 0, 0, 0, 0]),
        allocation=np.tile(np.eye(6)[:, :1], 2), command_limit=10.0, depth=0.5,
        reach=np.array([12.0, 0, 0, 0, 0, 0]), pace=np.array([0.35, 0.1, 0.1, 0.1, 0.1, 0.1]),
        length=0.9, tether=np.zeros(3),
    )  # fmt: skip


def _float() -> Vehicle:
    """A profiling float that only heaves, two vertical thrusters."""
    return Vehicle(
        name="float", dofs=(2,), mass=30.0, inertia=np.ones(3), r_g=np.zeros(3), r_b=np.zeros(3),
        added=-np.array([0, 0, 18.0, 0, 0, 0]), linear=-np.array([0, 0, 8.0, 0, 0, 0]),
        quadratic=-np.array([0, 0, 60.0, 0, 0, 0]),
        allocation=np.tile(np.eye(6)[:, 2:3], 2), command_limit=6.0, depth=12.0,
        reach=np.array([0, 0, 8.0, 0, 0, 0]), pace=np.array([0.1, 0.1, 0.25, 0.1, 0.1, 0.1]),
        length=0.4, tether=np.zeros(3),
    )  # fmt: skip


def _catamaran() -> Vehicle:
    """A small catamaran steered by differential thrust; sway is not driven."""
    columns = [rotor_column((-0.6, s * 0.35, 0), (1, 0, 0)) for s in (-1, 1)]
    allocation = np.column_stack(columns)
    return Vehicle(
        name="catamaran", dofs=(0, 1, 5), mass=60.0,
        inertia=np.array([6.0, 9.0, 12.0]), r_g=np.array([-0.08, 0, 0]), r_b=np.array([-0.08, 0, 0]),
        added=-np.array([5.0, 35.0, 0, 0, 0, 6.0]),
        linear=-np.array([8.0, 60.0, 0, 0, 0, 25.0]),
        quadratic=-np.array([18.0, 90.0, 0, 0, 0, 12.0]),
        allocation=allocation, command_limit=35.0, depth=0.0,
        reach=np.array([30.0, 0, 0, 0, 0, 15.0]), pace=np.array([0.7, 0.12, 0.1, 0.1, 0.1, 0.35]),
        length=1.5, tether=np.zeros(3),
    )  # fmt: skip


def _ship() -> Vehicle:
    """A model ship that rolls: a propeller (f1), tunnel thrusters at bow (f2) and stern (f3) below it.

    Its `r_b` is the metacentre.
    """
    columns = [rotor_column((-1.0, 0, 0), (1, 0, 0)), rotor_column((0.8, 0, 0.05), (0, 1, 0)),
               rotor_column((-0.9, 0, 0.08), (0, 1, 0))]  # fmt: skip
    return Vehicle(
        name="ship", dofs=(0, 1, 3, 5), mass=90.0,
        inertia=np.array([1.3, 20.0, 22.0]), r_g=np.array([0.05, 0, 0.02]), r_b=np.array([0.05, 0, -0.02]),
        added=-np.array([4.0, 60.0, 0, 0.5, 0, 10.0]),
        linear=-np.array([3.0, 40.0, 0, 1.2, 0, 22.0]),
        quadratic=-np.array([10.0, 180.0, 0, 0.8, 0, 18.0]),
        allocation=np.column_stack(columns), command_limit=12.0, depth=0.0,
        reach=np.array([6.0, 8.0, 0, 0, 0, 6.0]), pace=np.array([0.4, 0.1, 0.1, 0.08, 0.1, 0.18]),
        length=2.2, tether=np.zeros(3),
    )  # fmt: skip


def _micro_auv() -> Vehicle:
    """A hand-sized AUV: two forward thrusters (f1, f2), one lateral at the bow (f3), one vertical (f4)."""
    columns = [rotor_column((-0.15, -0.06, 0), (1, 0, 0)), rotor_column((-0.15, 0.06, 0), (1, 0, 0)),
               rotor_column((0.12, 0, 0), (0, 1, 0)), rotor_column((0, 0, 0), (0, 0, 1))]  # fmt: skip
    return Vehicle(
        name="micro-auv", dofs=(0, 1, 2, 5), mass=1.6,
        inertia=np.array([0.003, 0.006, 0.006]), r_g=np.zeros(3), r_b=np.zeros(3),
        added=-np.array([0.4, 1.2, 1.4, 0, 0, 0.004]),
        linear=-np.array([0.5, 1.6, 1.8, 0, 0, 0.05]),
        quadratic=-np.array([3.0, 9.0, 10.0, 0, 0, 0.015]),
        allocation=np.column_stack(columns), command_limit=1.5, depth=5.0,
        reach=np.array([1.2, 0.6, 0.8, 0, 0, 0.04]), pace=np.array([0.35, 0.12, 0.12, 0.1, 0.1, 0.45]),
        length=0.4, tether=np.array([-0.2, 0.0, 0.0]),
    )  # fmt: skip


def _heavy_rov() -> Vehicle:
    """A working-class ROV with four horizontal thrusters at 45 degrees (f1-f4), three vertical (f5-f7)."""
    diagonal = float(np.sqrt(0.5))
    flat = [rotor_column((0.4, s * 0.3, 0.0), (diagonal, -s * diagonal, 0)) for s in (1, -1)]
    flat += [rotor_column((-0.4, s * 0.3, 0.0), (diagonal, s * diagonal, 0)) for s in (1, -1)]
    upright = [rotor_column((x, y, 0), (0, 0, -1)) for x, y in ((0.3, 0.25), (0.3, -0.25), (-0.35, 0.0))]
    return Vehicle(
        name="heavy-rov", dofs=(0, 1, 2, 3, 4, 5), mass=120.0,
        inertia=np.array([8.0, 10.0, 11.0]), r_g=np.array([0.0, 0.0, 0.12]), r_b=np.zeros(3),
        added=-np.array([60.0, 110.0, 150.0, 5.0, 6.0, 7.0]),
        linear=-np.array([35.0, 45.0, 50.0, 8.0, 9.0, 10.0]),
        quadratic=-np.array([180.0, 260.0, 300.0, 30.0, 35.0, 40.0]),
        allocation=np.column_stack(flat + upright), command_limit=80.0, depth=15.0,
        reach=np.array([100.0, 100.0, 90.0, 12.0, 12.0, 25.0]),
        pace=np.array([0.45, 0.4, 0.35, 0.15, 0.15, 0.45]),
        length=1.2, tether=np.array([-0.4, 0.0, -0.3]),
    )  # fmt: skip


def _torpedo() -> Vehicle:
    """A slender AUV: a propeller (f1), lateral (f2, f3) and vertical (f4, f5) thrusters fore and aft."""
    columns = [rotor_column((-0.8, 0, 0), (1, 0, 0))]
    columns += [rotor_column((x, 0, 0), (0, 1, 0)) for x in (0.5, -0.5)]
    columns += [rotor_column((x, 0, 0), (0, 0, 1)) for x in (0.5, -0.5)]
    return Vehicle(
        name="torpedo", dofs=(0, 1, 2, 3, 4, 5), mass=32.0,
        inertia=np.array([0.3, 6.0, 6.0]), r_g=np.array([0.0, 0.0, 0.02]), r_b=np.zeros(3),
        added=-np.array([1.5, 28.0, 28.0, 0.05, 4.0, 4.0]),
        linear=-np.array([4.0, 45.0, 45.0, 0.6, 16.0, 16.0]),
        quadratic=-np.array([5.0, 90.0, 90.0, 0.3, 12.0, 12.0]),
        allocation=np.column_stack(columns), command_limit=15.0, depth=20.0,
        reach=np.array([9.0, 12.0, 8.0, 0, 1.5, 6.0]), pace=np.array([0.6, 0.12, 0.1, 0.12, 0.12, 0.25]),
        length=1.6, tether=np.array([-0.8, 0.0, 0.0]),
    )  # fmt: skip


#: The first three are older than the others and keep their place.
DRAWINGS: tuple[Vehicle, ...] = (
    _mini_auv(), _rov(), _usv(),
    _box(), _float(), _catamaran(), _ship(), _micro_auv(), _heavy_rov(), _torpedo(),
)  # fmt: skip
