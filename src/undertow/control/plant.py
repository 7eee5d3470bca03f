"""A vehicle in control form: M nu_dot + C(nu) nu + D(nu) nu + g(eta) = B inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
import sympy as sm

from undertow.errors import of_stated_kinds
from undertow.model.effect import Wrench, kinds_of
from undertow.model.effects.control_surfaces import ControlSurfaces
from undertow.model.effects.ocean_current import OceanCurrent, check_current
from undertow.model.symbols import POSE, body_rates, column, rotation, symbol
from undertow.model.vehicle import Value, Vehicle

_ZERO = sm.Integer(0)
WITH_MOTION = "its force depends on inputs and on the motion together"


class Plant:
    """The matrices of a vehicle in still water, as SymPy expressions derived from its effects.

    With a `speed` ahead, m/s, inputs whose force depends on the motion (fins, rudders) have the allocation
    of that speed; without one they have none. `vehicle` is the model as given without logged inputs, which no
    law commands, and without control surfaces where there is no speed.

    Every wrench is split by its dependence: its derivative in the acceleration goes to M, the part at rest to
    g, the part proportional to inputs to B, and the part due to motion to C (workless effects) or D (all
    others). Effects that do not fit are named in `left_out`, with the reason by id; simulations contain them,
    conditions on gains do not.
    """

    def __init__(self, vehicle: Vehicle, speed: float = 0.0) -> None:
        self.speed = speed
        self.left_out: dict[str, str] = {}
        self.vehicle = vehicle = _as_commanded(vehicle, speed, self.left_out)
        self._composition = _in_still_water(vehicle, self.left_out).composition
        # Pose (m and rad, NED) and velocity (m/s and rad/s, body frame) in its degrees of freedom, (n, 1).
        self.eta, self.nu = self._composition.eta, self._composition.nu
        n = len(vehicle.dof_indices)
        self._moving = sm.zeros(n, 1)
        # In the body frame: inertia with added mass, kg, kg m and kg m^2; D(nu), where D nu is the damping
        # force on the left-hand side; forces at rest there, N and N m (weight, buoyancy, bias), (n, 1); and
        # the force of a unit of each of the inputs, (n, n_inputs).
        self.M, self.D, self.g = sm.zeros(n, n), sm.zeros(n, n), sm.zeros(n, 1)
        self.B = sm.zeros(n, len(self.inputs))
        for effect, wrench in self._composition.wrenches.items():
            self._assign(effect, wrench.xreplace(self._unstated))

    # --- symbols ------------------------------------------------------------------------------
    @property
    def inputs(self) -> sm.Matrix:
        """What reaches thrusters, in units of the command; angles of surfaces; known forces, N and N m."""
        forces = [symbol(name) for name in self._composition.forces]
        inputs = [*self._composition.actuation, *forces]
        return sm.Matrix(len(inputs), 1, inputs)

    @cached_property
    def numbers(self) -> dict[sm.Symbol, sm.Expr]:
        """Value of every parameter that occurs, SI and SNAME signs."""
        names = [n for n in self._composition.parameter_names if symbol(n) not in self._unstated]
        return {symbol(n): sm.Float(self.vehicle.value_of(n).value) for n in names}

    @cached_property
    def _unstated(self) -> dict[sm.Symbol, sm.Expr]:
        """Zero for parameters that the file does not mention, so that M of most vehicles is diagonal."""
        names = [n for n in self._composition.parameter_names if n not in self.vehicle.values]
        return {symbol(n): _ZERO for n in names if not self.vehicle.value_of(n).value}

    # --- body frame ---------------------------------------------------------------------------
    @cached_property
    def C(self) -> sm.Matrix:
        """Coriolis matrix, shape (n, n), skew-symmetric.

        Workless forces f(nu) are quadratic, so f = F nu / 2 with F = df/dnu, and differentiating
        nu' f = 0 gives F' nu = -f. Hence (F - F') nu = 3 f: of all matrices that give the same force, a third
        of that difference is skew-symmetric.
        """
        # Derivative in which the sign of a velocity counts as constant: a set of parameters holds for one.
        slope = self._moving.jacobian(self.nu).replace(sm.DiracDelta, lambda *_: _ZERO)
        return (slope.T - slope) / 3

    @property
    def unactuated(self) -> list[int]:
        """Places of the degrees of freedom that no thruster pushes in."""
        return [i for i, row in enumerate(self.B.tolist()) if not any(row)]

    @property
    def thrust_matrix(self) -> np.ndarray:
        """B in numbers, shape (n, n_inputs)."""
        return np.array(self.B.xreplace(self.numbers).tolist(), dtype=float).reshape(self.B.shape)

    @cached_property
    def J(self) -> sm.Matrix:
        """Kinematics: d(eta)/dt = J(eta) nu, shape (n, n)."""
        return self._composition.pose_rate.jacobian(self.nu)

    @cached_property
    def J_dot(self) -> sm.Matrix:
        """Time derivative of J along the motion, shape (n, n)."""
        rate = self._composition.pose_rate
        terms = (self.J.diff(q) * v for q, v in zip(self.eta, rate, strict=True))
        return sum(terms, sm.zeros(*self.J.shape))

    @cached_property
    def J_inverse(self) -> sm.Matrix:
        """The inverse of J, shape (n, n), by its two blocks."""
        dofs = self.vehicle.dof_indices
        angles = column(POSE[3:])
        whole = {3: rotation(angles).T, 6: body_rates(angles)}
        blocks = []
        for first in (0, 3):
            own = [i for i, dof in enumerate(dofs) if first <= dof < first + 3]
            part = self.J.extract(own, own)
            full = len(own) == 3 and len(dofs) == 6
            blocks.append(whole[first + 3] if full else _inverse(part.as_immutable()))
        return sm.diag(*[b for b in blocks if b.rows])

    # --- sets of parameters by direction ------------------------------------------------------
    @cached_property
    def reversing(self) -> tuple[sm.Symbol, ...]:
        """Velocities whose sign switches parameters of the matrices M and D."""
        switched = [sm.Matrix([self.M]), sm.Matrix([self.D])]
        found = {a.args[0] for m in switched for a in m.atoms(sm.sign)}
        return tuple(v for v in self.nu if v in found)

    def with_signs(self, expression: sm.Matrix, signs: Mapping[sm.Symbol, int]) -> sm.Matrix:
        """An expression with the set of parameters of one direction, `signs` from `reversing` to 1 or -1."""
        return expression.xreplace({sm.sign(v): sm.Integer(s) for v, s in signs.items()})

    # --- sorting ------------------------------------------------------------------------------
    def _assign(self, effect: Wrench, wrench: sm.Matrix) -> None:
        # Derivative in the inputs, of which there may be none.
        by_input = wrench.jacobian(self.inputs) if len(self.inputs) else sm.zeros(wrench.rows, 0)
        reason = self._reason_left_out(effect, wrench, by_input)
        if reason:
            self.left_out[effect.id] = reason
            if self.speed and reason == WITH_MOTION:
                still = dict.fromkeys([*self.nu, *self.eta, *self.inputs], _ZERO)
                self.B += by_input.xreplace(still | {symbol("u"): sm.Float(self.speed)})
                self.left_out[effect.id] = f"its force is taken as at {self.speed:g} m/s ahead"
            return
        accelerations = self._composition.nu_dot
        at_rest = dict.fromkeys([*accelerations, *self.inputs], _ZERO)
        unforced = wrench.xreplace(at_rest)
        static = unforced.xreplace(dict.fromkeys(self.nu, _ZERO))
        moving = sm.Matrix(unforced - static)
        damping = sm.zeros(*self.M.shape) if effect.workless else _damping(moving, self.nu)
        if damping is None:
            self.left_out[effect.id] = "its force is no matrix times the velocity"
            return
        self.M -= wrench.jacobian(accelerations)
        self.B += by_input
        self.g -= static
        self.D += damping
        if effect.workless:
            self._moving += moving

    def _reason_left_out(self, effect: Wrench, wrench: sm.Matrix, by_input: sm.Matrix) -> str:
        """Why a wrench does not fit into the matrices, or nothing."""
        if wrench.free_symbols & set(effect.state_symbols):
            return "it has states of its own"
        if wrench.has(self._composition.signals.t):
            return "it depends on time"
        if by_input.free_symbols & {*self.nu, *self.eta, *self.inputs}:
            return WITH_MOTION
        return ""


@of_stated_kinds
def in_current(vehicle: Vehicle, north: float, east: float) -> Vehicle:
    """The vehicle in water that moves steadily over ground, m/s; a current of its file is replaced.

    Raises
    ------
    UndertowError
        If no water flows that fast.
    """
    check_current(north, east)
    return vehicle.with_effect(OceanCurrent, {"V_N": Value(north), "V_E": Value(east)})


def remedy_for_curves(vehicle: Vehicle) -> str:
    """What to do with thrusters whose thrust is not proportional to the command; empty if there are none."""
    nonlinear = [t for t in vehicle.thrusters if t.law is not None]
    if not nonlinear:
        return ""
    return (
        f"thrust of {', '.join(t.name for t in nonlinear)} is not proportional to the command (curve, "
        "revolutions): laws command newtons, so in a copy of the vehicle file give these thrusters a limit "
        "in N instead, that of the weaker direction (the exported C has the inverse of a curve)"
    )


@lru_cache(maxsize=32)
def _inverse(block: sm.ImmutableMatrix) -> sm.Matrix:
    """The inverse of a block of J, in few terms; the vehicles of a session have few such blocks."""
    return block.inv().applyfunc(sm.trigsimp) if block.rows else block


def _as_commanded(vehicle: Vehicle, speed: float, left_out: dict[str, str]) -> Vehicle:
    """The vehicle without logged inputs and, without a speed, without control surfaces."""
    unused = () if speed else vehicle.surfaces
    if not unused and not vehicle.inputs:
        return vehicle
    reason = "it stays at zero: laws command surfaces only at a forward speed ([allocation] speed)"
    left_out |= {s.name: reason for s in unused}
    left_out |= {name: "an input from the log: laws take it as zero" for name in vehicle.inputs}
    kept = tuple(e for e in vehicle.effects if not unused or ControlSurfaces.id not in e.requires)
    commanded = replace(vehicle, effects=kept, surfaces=() if unused else vehicle.surfaces, inputs={})
    return commanded.with_values(
        {n: Value(0.0) for n in vehicle.inputs if n in commanded.declared_parameters}
    )


def _in_still_water(vehicle: Vehicle, left_out: dict[str, str]) -> Vehicle:
    """The vehicle without flow, actuation and measurement effects."""
    for effect in vehicle.all_effects:
        other = [k for k in kinds_of(effect) if k != "wrench"]
        if other:
            left_out[effect.id] = f"{other[0]}: conditions are for still water, ideal thrust and true states"
    kept = tuple(e for e in vehicle.effects if e.id not in left_out)
    ids = {e.id for e in kept} | {"thrusters", ControlSurfaces.id}
    for effect in kept:
        if not set(effect.requires) <= ids:
            left_out[effect.id] = f"it needs {', '.join(effect.requires)}"
    return replace(vehicle, effects=tuple(e for e in kept if e.id not in left_out))


def _damping(force: sm.Matrix, nu: sm.Matrix) -> sm.Matrix | None:
    """A matrix D with force = -D nu, or None where a term has no velocity as a factor."""
    matrix = sm.zeros(len(force), len(nu))
    for i, row in enumerate(force):
        for term in sm.Add.make_args(sm.expand(row)):
            j = _column(term, i, nu)
            if j is None:
                return None
            if term != 0:
                matrix[i, j] -= term / nu[j]
    return matrix


def _column(term: sm.Expr, row: int, nu: sm.Matrix) -> int | None:
    """The velocity to which a term is attributed: the row's own, else the last one (u r to r)."""
    powers = term.as_powers_dict()
    factors = [j for j, v in enumerate(nu) if powers.get(v, 0) >= 1]
    if term == 0 or row in factors:
        return row
    return factors[-1] if factors else None
