"""Audits of equations: those of the mini-AUV paper, and a vehicle's own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sm

from undertow.control.conditions.by_law import CANDIDATES, CONDITIONS, Quantities
from undertow.control.conditions.problem import SignSet, sign_sets
from undertow.control.laws import LAWS, LawSignals
from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.composition import function_of
from undertow.model.effect import Wrench
from undertow.model.loading import load_vehicle
from undertow.model.plausibility import hints
from undertow.model.symbols import symbol
from undertow.model.units import dimension_of, unit_text
from undertow.model.vehicle import Vehicle
from undertow.typing import Array


@dataclass(frozen=True)
class Discrepancy:
    """Something that does not fit, or that is left open."""

    kind: str  # "wrong", or "open" for what is missing or only assumed
    where: str  # equation, matrix or effect
    text: str  # what it is
    evidence: str  # the computation that shows it


WRONG, OPEN = "wrong", "open"


def audit_paper() -> list[Discrepancy]:
    """Everything in equations (8) to (15), (24), (25) and the PID conditions that does not fit."""
    equations = _Equations()
    return [
        *equations.coriolis_sign(),
        *equations.power(),
        *equations.frames(),
        *equations.munk(),
        *condition_units(),
        *equations.zero_set(),
        *equations.missing(),
    ]


class _Equations:
    """Printed and derived matrices in the paper's positive magnitudes, forward parameters."""

    def __init__(self) -> None:
        vehicle = load_vehicle("mini-auv")
        self.full = vehicle
        self.vehicle = replace(
            vehicle, effects=tuple(e for e in vehicle.effects if not (isinstance(e, Wrench) and e.workless))
        )
        self.plant = Plant(self.vehicle)
        self.added = [symbol(n) for n in ("X_udot", "Y_vdot", "Z_wdot", "N_rdot")]
        self.r, self.psi = symbol("r"), symbol("psi")

    def forward(self, matrix: sm.Matrix) -> sm.Matrix:
        """An expression of the forward set with the paper's names and signs."""
        one = self.plant.with_signs(matrix, dict.fromkeys(self.plant.reversing, 1))
        sides = self.vehicle.sides.items()
        names = {symbol(n): symbol(p.name) for n, (p, way) in sides if way == "forward"}
        return one.xreplace(names).xreplace({a: -a for a in self.added}).applyfunc(sm.expand)

    @cached_property
    def J_rate(self) -> sm.Matrix:
        """J_dot = dJ/dpsi r."""
        return self.plant.J.diff(self.psi) * self.r

    @cached_property
    def printed(self) -> sm.Matrix:
        """C_q as (11) prints it."""
        X, Y = self.added[:2]
        s, c = sm.sin(self.psi), sm.cos(self.psi)
        rows = [
            [-s * c * (Y - X), -(s**2 * Y + c**2 * X), 0, 0],
            [c**2 * Y + s**2 * X, s * c * (Y - X), 0, 0],
            [0, 0, 0, 0],
            [0, 0, 0, 0],
        ]
        return sm.Matrix(rows) * self.r

    @cached_property
    def mass(self) -> sm.Matrix:
        """M_gamma of (10), derived."""
        return self.forward(self.plant.M)

    def in_body_axes(self, matrix: sm.Matrix) -> sm.Matrix:
        """J' matrix J."""
        return (self.plant.J.T * matrix * self.plant.J).applyfunc(lambda e: sm.trigsimp(sm.expand(e)))

    def rate(self) -> sm.Matrix:
        """Time derivative of M_q = J M J'."""
        return (self.plant.J * self.mass * self.plant.J.T).diff(self.psi) * self.r

    # --- findings
    def coriolis_sign(self) -> Iterator[Discrepancy]:
        added = sm.diag(*self.added)
        derived = self.plant.J * added * self.J_rate.T
        if _zero(self.printed + derived) and not _zero(self.printed - derived):
            yield Discrepancy(
                WRONG,
                "(11)",
                "C_q has the wrong sign",
                "it equals -J M_a J_dot', but J M_a J_dot' follows from (9) by q_dot = J gamma",
            )

    def power(self) -> Iterator[Discrepancy]:
        balance = self.in_body_axes(self.rate() - 2 * self.printed)
        symmetric = (balance + balance.T) / 2
        fixed = self.in_body_axes(self.rate() + 2 * self.printed)
        if not _zero(symmetric) and _zero(fixed + fixed.T):
            names = ("X_udot_forward", "Y_vdot", "Z_wdot_forward", "N_rdot")
            values = (-sm.Float(self.vehicle.value_of(n).value) for n in names)
            numbers = dict(zip(self.added, values, strict=True))
            size = symmetric[0, 1].xreplace(numbers | {self.r: sm.Integer(1)})
            yield Discrepancy(
                WRONG,
                "(10), (11)",
                "d(M_q)/dt - 2 C_q is not skew-symmetric, so energy comes from nowhere in turns",
                f"symmetric part in body axes {sm.factor(symmetric[0, 1])} off the diagonal, "
                f"{float(size):.7g} kg/s with Table 4 at r = 1 rad/s; "
                "with the sign of (11) changed it is skew-symmetric",
            )

    def frames(self) -> Iterator[Discrepancy]:
        """(8) with the sign of (11) fixed, less what (9) becomes in the inertial frame."""
        J, nu = self.plant.J, self.plant.nu
        equivalent = J * self.mass * self.J_rate.T
        extra = self.in_body_axes(-self.printed - equivalent) * nu
        if not _zero(extra):
            shown = ", ".join(str(sm.factor(e)) for e in extra)
            yield Discrepancy(
                WRONG,
                "(8), (9)",
                "even with the sign of (11) fixed, (8) is not (9) in the inertial frame",
                f"(8) has ({shown}) more in body axes: its C_q lacks the mass; "
                "they are equal with J M_gamma J_dot'",
            )

    def munk(self) -> Iterator[Discrepancy]:
        complete = Plant(self.full)
        dropped = self.forward((complete.C - self.plant.C) * self.plant.nu)
        moment = sm.factor(dropped[3])
        if moment != 0:
            shown = ", ".join(str(sm.factor(e)) for e in dropped[:2])
            yield Discrepancy(
                WRONG,
                "(8), (9)",
                "the Munk moment is absent from both, and the Coriolis forces from (9)",
                f"the effects give the moment {moment} on the left-hand side, and the forces {shown}",
            )

    def zero_set(self) -> Iterator[Discrepancy]:
        s = LawSignals(self.plant, LAWS["pd"]())
        rest = CANDIDATES["pd"].derivative(s).xreplace(dict.fromkeys(self.plant.nu, sm.Integer(0)))
        if rest == 0:
            yield Discrepancy(
                WRONG,
                "text below (25)",
                "the set of all states with V_dot = 0 is not q~ = 0, gamma = 0",
                "(25) is zero at gamma = 0 for every q~; the printed set is its largest invariant subset",
            )

    def missing(self) -> Iterator[Discrepancy]:
        present = self.plant.M.free_symbols | self.plant.D.free_symbols
        assumed = [n for n, v in self.vehicle.values.items() if v.assumed and symbol(n) in present]
        if assumed:
            hint = next(h for h in hints(self.full) if h.startswith("assumed"))
            yield Discrepancy(
                OPEN,
                "(10), (12)",
                f"{', '.join(assumed)} are in the matrices, but the paper prints no value",
                f"the bundled vehicle file says: {hint}",
            )


def _zero(matrix: sm.Matrix) -> bool:
    return matrix.applyfunc(lambda e: sm.trigsimp(sm.expand(e))).is_zero_matrix is True


def condition_units() -> Iterator[Discrepancy]:
    """Printed PID conditions whose units do not fit, neither with iota a pure number nor with iota in 1/s."""
    units = {g.name: g.force for g in LAWS["pid"].gains} | {"M": "kg", "D": "kg/s"}
    s = Quantities({name: symbol(name) for name in (*units, "iota")})
    for condition in CONDITIONS["pid"]:
        if condition.form != "printed":
            continue
        complaints = []
        for iota in ("1", "1/s"):
            known = {symbol(n): u for n, u in (units | {"iota": iota}).items()}
            complaint = _mismatch(condition.left(s), condition.right(s), known)
            if complaint:
                complaints.append(f"iota in {iota}: {complaint}" if condition.uses_iota else complaint)
        if len(complaints) == 2:
            yield Discrepancy(
                WRONG,
                "PID conditions",
                f"the units of {condition.statement} do not fit",
                "; ".join(dict.fromkeys(complaints)),
            )


def _mismatch(left: sm.Expr, right: sm.Expr, units: dict[sm.Symbol, str]) -> str:
    """What is wrong with the units of a comparison, or nothing."""
    try:
        one, other = dimension_of(left, units), dimension_of(right, units)
    except UndertowError as error:
        return str(error)
    fits = one is None or other is None or one == other
    return "" if fits else f"{left} is {unit_text(one)}, {right} {unit_text(other)}"


@dataclass(frozen=True)
class AuditSettings:
    """How equations are audited: definiteness, and power at random states."""

    random_states: int = 200
    seed: int = 20210405  # of the random states
    named: float = 1e-3  # share of a unit motion from which a velocity is named
    rounding: float = 1e-9  # eigenvalue or power, relative to the largest, or to one, that is rounding


SETTINGS = AuditSettings()


def audit_vehicle(vehicle: Vehicle) -> list[Discrepancy]:
    """Everything that does not fit in the equations of a vehicle, and what its file leaves open."""
    plant = Plant(vehicle)
    return [
        *_symmetry(plant),
        *_skew(plant),
        *(found for one in sign_sets(plant) for found in _damping(plant, one)),
        *_power(vehicle),
        *(
            Discrepancy(OPEN, "vehicle file", hint, "what the file states and what it does not")
            for hint in hints(vehicle)
        ),
        *(Discrepancy(OPEN, i, "is in none of the matrices", reason) for i, reason in plant.left_out.items()),
    ]


def _symmetry(plant: Plant) -> Iterator[Discrepancy]:
    difference = (plant.M - plant.M.T).applyfunc(sm.expand)
    if not difference.is_zero_matrix:
        yield Discrepancy(WRONG, "M", "the mass matrix is not symmetric", f"M - M' has {_first(difference)}")


def _skew(plant: Plant) -> Iterator[Discrepancy]:
    """With C skew-symmetric, d(M_q)/dt - 2 C_q is so as well, whatever J."""
    total = (plant.C + plant.C.T).applyfunc(sm.expand)
    if not total.is_zero_matrix:
        yield Discrepancy(
            WRONG, "C", "no skew-symmetric C gives the Coriolis force", f"C + C' has {_first(total)}"
        )


def _first(matrix: sm.Matrix) -> str:
    i, j = next((i, j) for i in range(matrix.rows) for j in range(matrix.cols) if matrix[i, j] != 0)
    return f"{matrix[i, j]} in row {i + 1}, column {j + 1}"


def _damping(plant: Plant, one: SignSet) -> Iterator[Discrepancy]:
    symmetric = 0.5 * (one.damping + one.damping.T)
    values, vectors = np.linalg.eigh(symmetric)
    if values[0] < -SETTINGS.rounding * max(1.0, abs(values[-1])):
        of = f" ({one.name})" if one.name else ""
        along = ", ".join(
            f"{v} = {x:.3g}" for v, x in zip(plant.nu, vectors[:, 0], strict=True) if abs(x) > SETTINGS.named
        )
        yield Discrepancy(
            WRONG,
            "D",
            f"damping at rest{of} feeds energy into a motion",
            f"nu' D nu = {values[0]:.4g} for {along}",
        )


def _power(vehicle: Vehicle) -> Iterator[Discrepancy]:
    """Power of each effect at random states: none where it is workless, none above zero if dissipative."""
    powers = vehicle.power()
    for effect in vehicle.effects:
        if not isinstance(effect, Wrench) or not (effect.workless or effect.dissipative):
            continue
        terms = _terms_at_random(powers[effect.id], vehicle)
        terms = terms[:, np.isfinite(terms).all(axis=0)]
        values = terms.sum(axis=0)
        # Rounding of a sum grows with its terms, which are large where they cancel in a large ship.
        limit = SETTINGS.rounding * max(1.0, float(np.abs(terms).sum(axis=0).max(initial=0.0)))
        if effect.workless and np.abs(values).max(initial=0.0) > limit:
            worst = float(values[np.abs(values).argmax()])
            yield Discrepancy(
                WRONG, effect.id, "claims to do no work but does", f"{worst:.4g} W at a random state"
            )
        if effect.dissipative and values.max(initial=0.0) > limit:
            yield Discrepancy(
                WRONG,
                effect.id,
                "claims to take energy but feeds it in with the values of the file",
                f"{float(values.max()):.4g} W at a random state, of {SETTINGS.random_states}",
            )


def _terms_at_random(power: sm.Expr, vehicle: Vehicle) -> Array:
    """Terms of a power at random states, W, shape (terms, states)."""
    known = {symbol(n): sm.Float(vehicle.value_of(n).value) for n in vehicle.parameter_names}
    terms = [term.xreplace(known) for term in sm.Add.make_args(power)]
    names = sorted(set().union(*(term.free_symbols for term in terms)), key=str)
    count = SETTINGS.random_states
    generator = np.random.default_rng(SETTINGS.seed)
    with np.errstate(all="ignore"):
        found = function_of(names, terms, "numpy")(*generator.uniform(-1.0, 1.0, (len(names), count)))
    return np.array([np.broadcast_to(np.asarray(term, dtype=float), count) for term in found])
