"""The prepared form of the dynamics: equal to the plain one, and with few operations."""

from __future__ import annotations

from functools import cache

import casadi as ca
import mpmath
import numpy as np
import pytest
import sympy as sm

from benchmarks.speed import vehicle as bench
from tests.codegen.support import (
    BASE,
    BUNDLED,
    DIGITS,
    EFFECTS,
    SPREAD,
    Reference,
    assert_close,
    doubles,
    exact,
    functions_of,
    random_point,
    vehicle_with,
)
from tests.quick import first_quick, quick_if
from undertow.codegen.expressions import Inertia, find_inertia, kirchhoff
from undertow.codegen.functions import Functions
from undertow.model.effect import Wrench
from undertow.model.parameter import Parameter
from undertow.model.symbols import DOFS, Signals, coriolis
from undertow.model.vehicle import Vehicle

# Operations of one evaluation: at most so many, and a share of what the plain dynamics take.
MOST = {
    "bench": (380, 0.54),
    "bluerov2": (293, 0.71),
    "box-hull": (6, 0.75),
    "cybership2": (90, 0.63),
    "mini-auv": (90, 0.72),
}
_NOTHING = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ASSIGN}
CURRENT = "ocean_current"
CORIOLIS = ("rigid_body_coriolis", "added_mass_coriolis", "added_mass_coupling", "entrained_water")
SUBSETS = [
    ("surge",),
    ("yaw",),
    ("surge", "yaw"),
    ("surge", "sway", "yaw"),
    ("roll", "pitch", "yaw"),
    ("surge", "sway", "roll", "yaw"),
    ("surge", "heave", "pitch"),
    ("surge", "sway", "heave", "yaw"),
    DOFS,
]


@cache
def _functions(name: str) -> Functions:
    return bench.functions() if name == "bench" else functions_of(name)


def operations(function: ca.Function) -> int:
    """How many operations an evaluation takes."""
    return sum(function.instruction_id(k) not in _NOTHING for k in range(function.n_instructions()))


def _assert_equal(functions: Functions, seed: int) -> None:
    plain, prepared, point = functions.dynamics, functions.prepared, random_point(functions, seed)
    expected = np.array(plain(point.x, point.u, point.p, point.t)).ravel()
    q = prepared.prepare(point.p)
    assert_close(np.array(prepared.dynamics(point.x, point.u, q, point.t)).ravel(), expected)
    held = prepared.held_dynamics(point.x, prepared.hold(point.u, q), q, point.t)
    assert_close(np.array(held).ravel(), expected)


# --- equality -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", quick_if(["bench", "full", *BUNDLED, *SPREAD].__contains__, ["bench", "full", *BUNDLED, *EFFECTS])
)
def test_it_is_the_dynamics(name: str) -> None:
    for seed in (1, 2, 3):
        _assert_equal(_functions(name), seed)


@pytest.mark.parametrize("dofs", SUBSETS, ids="-".join)
@pytest.mark.parametrize("flow", first_quick(["ocean_current", "waves"]))
def test_it_is_the_dynamics_in_any_degrees_of_freedom(dofs: tuple[str, ...], flow: str) -> None:
    functions = Functions(vehicle_with(*CORIOLIS, flow, dofs=dofs))
    for seed in (1, 2):
        _assert_equal(functions, seed)


@pytest.mark.parametrize("ids", [("added_mass_coriolis",), ("added_mass_coupling", "rigid_body_coriolis")])
def test_coriolis_forces_may_be_left_out(ids: tuple[str, ...]) -> None:
    """Then a current is felt by the vehicle's own inertia, too."""
    _assert_equal(Functions(vehicle_with(*ids, CURRENT)), 1)


def test_it_is_the_model_by_mpmath() -> None:
    functions = bench.functions()
    prepared, reference = functions.prepared, Reference(functions)
    with mpmath.workdps(DIGITS):
        for seed in range(3):
            point = random_point(functions, seed)
            found = prepared.dynamics(point.x, point.u, prepared.prepare(point.p), point.t)
            assert_close(np.array(found).ravel(), doubles(reference.x_dot(*exact(point))))


def test_tied_parameters_stay_tied() -> None:
    functions = Functions(vehicle_with("quadratic_damping"), equal={"Y_v": ("X_u", 2.0)})
    _assert_equal(functions, 1)


def test_inertia_that_differs_ahead_and_astern_is_solved_for_in_every_evaluation() -> None:
    """The mass matrix then depends on the state: no inverse can be prepared."""
    vehicle = vehicle_with("added_mass_coriolis", CURRENT)
    halves = {"X_udot_forward": -5.0, "X_udot_backward": -7.0}
    split = Vehicle("split", DOFS, vehicle.effects, halves, vehicle.thrusters)  # type: ignore[arg-type]
    functions = Functions(split)
    assert ca.depends_on(functions.mass_matrix, functions.x)
    for seed in (1, 2, 3):
        _assert_equal(functions, seed)


# --- cost ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MOST)
def test_it_takes_few_operations(name: str) -> None:
    functions = _functions(name)
    plain, found = operations(functions.dynamics), operations(functions.prepared.dynamics)
    most, share = MOST[name]
    assert found <= most
    assert found <= share * plain


@pytest.mark.parametrize("name", ["full", *EFFECTS])
def test_no_effect_costs_more_than_it_did(name: str) -> None:
    functions = _functions(name)
    assert operations(functions.prepared.dynamics) <= 0.9 * operations(functions.dynamics)


def test_commands_that_are_held_are_worked_out_once() -> None:
    prepared = bench.functions().prepared
    assert operations(prepared.held_dynamics) <= operations(prepared.dynamics) - operations(prepared.hold)
    assert prepared.hold.numel_out(0) == 6


def test_like_coefficients_are_collected() -> None:
    """Weight and buoyancy pull the same way: their difference is known before the attitude is."""
    full, less = (
        Functions(vehicle_with(*ids, dofs=("heave",)))
        for ids in (("restoring", "net_buoyancy", "hull_compressibility"), ("hull_compressibility",))
    )
    assert {"W", "B", "B_net"} == {*full.parameter_names} - {*less.parameter_names}
    assert operations(full.prepared.dynamics) == operations(less.prepared.dynamics)


# --- what is inertial ---------------------------------------------------------------------------


def _inertia(f: Functions) -> Inertia:
    signals = f.vehicle.composition.signals
    return find_inertia(f.stated, signals, f.convert, f.p, f.vehicle.dof_indices)


def test_inertial_effects_are_found() -> None:
    # Its thrusters push ahead: no force of a rudder at all, which has no part that is not inertial.
    nothing = {"rudder_force"}
    assert {*_inertia(functions_of("full")).ids} == {"rigid_body", "added_mass", *CORIOLIS} | nothing


@pytest.mark.parametrize("dofs", SUBSETS, ids="-".join)
def test_their_sum_is_what_the_momenta_say(dofs: tuple[str, ...]) -> None:
    functions = Functions(vehicle_with(*CORIOLIS, dofs=dofs))
    inertia = _inertia(functions)
    rows = list(functions.vehicle.dof_indices)
    nu, nu_dot = (ca.SX(6, 1) for _ in range(2))
    nu[rows], nu_dot[rows] = functions.nu, functions.nu_dot
    momentum = inertia.momentum + inertia.water_momentum
    force = -(inertia.mass + inertia.water_mass) @ nu_dot - kirchhoff(momentum, nu)
    stated = sum((functions.wrenches[i] for i in inertia.ids), ca.SX(len(rows), 1))
    both = ca.Function("both", [functions.nu, functions.nu_dot, functions.p], [force[rows], stated])
    random = np.random.default_rng(0)
    found, expected = both(
        *(random.uniform(-1, 1, s.numel()) for s in (functions.nu, functions.nu_dot, functions.p))
    )
    assert_close(np.array(found).ravel(), np.array(expected).ravel())


class _Odd(Wrench):
    """A wrench that looks like a Coriolis force."""

    id = "odd"
    family = "inertia"
    reference = "none"
    odd = Parameter("kg", "its size")
    extra = 0

    def wrench(self, s: Signals) -> sm.Matrix:
        force = -coriolis(self.odd * sm.eye(6), s.nu) * s.nu
        return force + self.odd * self.extra * sm.Matrix([s.nu[5] * s.nu[0], 0, 0, 0, 0, 0])


class _NearlyKirchhoff(_Odd):
    """One term of the wrong kind, however small, and it is no Coriolis force."""

    extra = sm.Float(1e-9)


class _Lopsided(_Odd):
    """Inertia and a Coriolis force of another matrix, which is allowed."""

    def wrench(self, s: Signals) -> sm.Matrix:
        return super().wrench(s) - 2 * self.odd * s.nu_dot


class _Restless(_Odd):
    """A Coriolis force that is there at rest, too."""

    def wrench(self, s: Signals) -> sm.Matrix:
        return super().wrench(s) + self.odd * sm.Matrix([0, 0, s.nu[2], 0, 0, 0])


@pytest.mark.parametrize(
    ("cls", "inertial"), [(_Odd, True), (_NearlyKirchhoff, False), (_Lopsided, True), (_Restless, False)]
)
def test_a_users_wrench_is_judged_by_what_it_states(cls: type[_Odd], inertial: bool) -> None:
    base = vehicle_with(*BASE)
    names = tuple(t.name for t in base.thrusters)
    functions = Functions(Vehicle("odd", DOFS, (*base.effects, cls(names)), {}, base.thrusters))
    assert ("odd" in _inertia(functions).ids) == inertial
    _assert_equal(functions, 1)
