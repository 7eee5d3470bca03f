"""The conditions on the gains of every law, and its Lyapunov candidate with the rate along the loop."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from random import Random
from typing import Any, ClassVar, cast

import numpy as np
import sympy as sm

from undertow.control.laws import Law, LawSignals, sliding_surface
from undertow.control.plant import Plant
from undertow.model.composition import function_of
from undertow.model.symbols import symbol

from .attitude import block, least_eigenvalue, transposed

FORMS = {
    "printed": "as the mini-AUV paper prints them",
    "units": "the printed ones with consistent units (ι in 1/s)",
    "derived": "derived from the model itself",
}
"""Where a condition comes from."""


class Quantities:
    """What a condition may use: gains by name, M, D and iota, as symbols, numbers, matrices or intervals."""

    def __init__(self, quantities: Mapping[str, Any]) -> None:
        self._quantities = dict(quantities)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._quantities:
            raise AttributeError(f"no condition can use '{name}'")
        return self._quantities[name]

    def block(self, rows: Sequence[Sequence[Any]]) -> Any:
        """A matrix of blocks."""
        if any(isinstance(cell, sm.Basic) for row in rows for cell in row):
            return sm.Matrix([list(row) for row in rows])
        return block(rows)

    def root(self, value: Any) -> Any:
        """Square root of a number or symbol that is not negative."""
        return sm.sqrt(value) if isinstance(value, sm.Basic) else np.sqrt(np.maximum(value, 0.0))

    def transposed(self, value: Any) -> Any:
        """The transpose of a matrix; a scalar is its own."""
        return value if isinstance(value, sm.Basic) else transposed(value)


Side = Callable[[Quantities], Any]


@dataclass(frozen=True)
class Condition:
    """A demand `left > right` on gains.

    For a given iota the left side is concave and the right side convex in M and D together, so that over
    a box or a polytope of parameters the margin is least at a corner; it is concave in every single gain and
    in iota, too, so that the values that satisfy it are an interval.
    """

    id: str
    form: str  # one of FORMS
    statement: str  # the demand on one channel, as text
    # The demand on matrices in the paper's notation: eigenvalues that are compared (λmin, λmax), or a matrix
    # that is positive definite (≻ 0); nothing where it is stated for one channel only.
    matrices: str
    about: str  # what it is for, one sentence
    source: str
    left: Side  # what has to be the larger side
    smaller: Side | None = None  # what has to be the smaller one; zero unless stated
    uses: str = ""  # which of M and D it contains
    uses_iota: bool = False
    # Whether the smallest eigenvalue of the left is compared with the largest of the right side; otherwise
    # the difference has to be positive definite.
    eigenvalues: bool = False

    @property
    def per_channel_only(self) -> bool:
        """Whether it is stated for one channel (a scalar) and not for matrices."""
        return not self.matrices

    def right(self, s: Quantities) -> Any:
        """What has to be the smaller side."""
        return self.smaller(s) if self.smaller else 0.0 * self.left(s)

    def margin(self, s: Quantities) -> Any:
        """How far the condition is from failing; a lower bound of it where the quantities are intervals."""
        left = self.left(s)
        if self.smaller is None:
            return least_eigenvalue(left)
        right = self.smaller(s)
        if self.eigenvalues:
            return least_eigenvalue(left) + least_eigenvalue(-right)
        return least_eigenvalue(left - right)

    def sides(self, s: Quantities) -> tuple[float, float]:
        """Smallest eigenvalue of the left and largest of the right side."""
        return float(least_eigenvalue(self.left(s))), -float(least_eigenvalue(-self.right(s)))


# --- PD -------------------------------------------------------------------------------------------
_PD_SOURCE = "derived here from V = q_dot' M q_dot/2 + e' K_P e/2 along the closed loop"

PD_SPRING = Condition(
    "K_P", "printed", "K_P > 0", "K_P ≻ 0",
    "The Lyapunov function (24) is positive, so that the set-point is its minimum.",
    "mini-AUV paper (2021), text of (20)",
    lambda s: s.K_P,
)  # fmt: skip
PD_DAMPER = Condition(
    "K_V", "printed", "K_V > 0", "K_V ≻ 0",
    "The law itself dissipates energy in every motion, as the paper requires for (25).",
    "mini-AUV paper (2021), text of (20) and (25)",
    lambda s: s.K_V,
)  # fmt: skip
DERIVED_PD_DAMPER = Condition(
    "K_V + D", "derived", "K_V + D > 0", "K_V + D_q ≻ 0",
    "Law and water together dissipate energy in every motion; V_dot = -q_dot' (K_V + D_q) q_dot.",
    _PD_SOURCE,
    lambda s: s.K_V + s.D, uses="D",
)  # fmt: skip

# --- PID ------------------------------------------------------------------------------------------
_PAPER = "mini-AUV paper (2021), text between (33) and (34)"
_UNITS = f"{_PAPER}, with units corrected"
_PID_SOURCE = "derived here from V and V_dot along the closed loop"

PRINTED_DAMPER = Condition(
    "K_V", "printed", "K_V > M", "λmin(K_V) > λmax(M_q)",
    "The paper asks the damping gains to exceed the inertia, though kg/s and kg cannot be compared.",
    _PAPER,
    lambda s: s.K_V, lambda s: s.M, uses="M", eigenvalues=True,
)  # fmt: skip
PRINTED_INTEGRAL = Condition(
    "K_I", "printed", "K_I > 0", "K_I ≻ 0",
    "The integral pushes towards the set-point.",
    _PAPER,
    lambda s: s.K_I,
)  # fmt: skip
PRINTED_SPRING = Condition(
    "K_P", "printed", "K_P > K_V + 2 K_I/ι", "λmin(K_P) > λmax(K_V + 2 K_I/ι)",
    "The spring outweighs damper and integral; the smallest gain of all axes against the largest.",
    _PAPER,
    lambda s: s.K_P, lambda s: s.K_V + 2 * s.K_I / s.iota, uses_iota=True, eigenvalues=True,
)  # fmt: skip
PRINTED_LAST = Condition(
    "last", "printed", "(1 - ι) K_P/2 > ι M", "(1 - ι) K_P/2 - ι M_q ≻ 0",
    "The block of the velocities in V_dot at the set-point; presumably K_V is meant where K_P is printed.",
    _PAPER,
    lambda s: (1 - s.iota) * s.K_P / 2, lambda s: s.iota * s.M, uses="M", uses_iota=True,
)  # fmt: skip
UNITS_DAMPER = Condition(
    "K_V", "units", "K_V > ι M", "λmin(K_V) > λmax(ι M_q)",
    "Damping gains exceed inertia times ι, both in kg/s.",
    _UNITS,
    lambda s: s.K_V, lambda s: s.iota * s.M, uses="M", uses_iota=True, eigenvalues=True,
)  # fmt: skip
UNITS_SPRING = Condition(
    "K_P", "units", "K_P > ι K_V + 2 K_I/ι", "λmin(K_P) > λmax(ι K_V + 2 K_I/ι)",
    "The spring outweighs damper and integral, all in N/m.",
    _UNITS,
    lambda s: s.K_P, lambda s: s.iota * s.K_V + 2 * s.K_I / s.iota, uses_iota=True, eigenvalues=True,
)  # fmt: skip
# iota e' K q_dot is at most iota^2 e' K e/2 + q_dot' K q_dot/2, which leaves half of K_V here.
UNITS_LAST = Condition(
    "last", "units", "K_V/2 > ι M", "K_V/2 - ι M_q ≻ 0",
    "The block of the velocities in V_dot with K_V in it, both sides in kg/s.",
    _UNITS,
    lambda s: s.K_V / 2, lambda s: s.iota * s.M, uses="M", uses_iota=True,
)  # fmt: skip
POSITIVE_CANDIDATE = Condition(
    "V", "derived", "K_P - K_I/ι > ι² M", "K_P - K_I/ι - ι² M_q ≻ 0",
    "The Lyapunov function is positive everywhere but at the set-point.",
    _PID_SOURCE,
    lambda s: s.K_P - s.K_I / s.iota, lambda s: s.iota**2 * s.M, uses="M", uses_iota=True,
)  # fmt: skip


def _negative_candidate_rate(s: Quantities) -> Any:
    K = s.K_V + s.D
    cross = s.iota * K / 2
    return s.block([[s.iota * s.K_P - s.K_I, cross], [s.transposed(cross), K - s.iota * s.M]])


FALLING_CANDIDATE = Condition(
    "V_dot", "derived", "Q(ι) ≻ 0", "Q(ι) ≻ 0",
    "The Lyapunov function falls along every motion near the set-point; "
    "Q = [[ι K_P - K_I, ι K/2], [ι K/2, K - ι M_q]] with K = K_V + D_q.",
    _PID_SOURCE,
    _negative_candidate_rate, uses="MD", uses_iota=True,
)  # fmt: skip
# The determinant of the block is a parabola in iota with discriminant (K k_p - M k_i)^2 - k_i K^3. Where it
# is positive, V is as well: K^2/4 >= iota M (K - iota M) always.
SOME_IOTA = Condition(
    "some iota", "derived", "K k_p - M k_i > K √(K k_i), K = k_v + d", "",
    "Necessary and sufficient for an ι with which this channel has a Lyapunov function.",
    _PID_SOURCE,
    lambda s: (s.K_V + s.D) * s.K_P - s.M * s.K_I,
    lambda s: (s.K_V + s.D) * s.root((s.K_V + s.D) * s.K_I), uses="MD",
)  # fmt: skip
ROUTH = Condition(
    "Routh", "derived", "K k_p > M k_i, K = k_v + d", "",
    "Necessary and sufficient for the channel, linearised at rest, to be stable (Routh-Hurwitz).",
    "Routh-Hurwitz criterion on M s^3 + K s^2 + k_p s + k_i",
    lambda s: (s.K_V + s.D) * s.K_P, lambda s: s.M * s.K_I, uses="MD",
)  # fmt: skip

# --- sliding modes --------------------------------------------------------------------------------
_SLIDING_REFERENCE = "mini-AUV paper (2021), text of (34) and (35)"

REACHES = Condition(
    "K_Z", "printed", "K_Z > 0", "K_Z ≻ 0",
    "S' S_dot = -sum K_Z |S| is negative: the surface is reached in the time |S|/K_Z.",
    _SLIDING_REFERENCE,
    lambda s: s.K_Z,
)  # fmt: skip
SLIDES = Condition(
    "Lambda", "printed", "Λ > 0", "Λ ≻ 0",
    "On the surface e_dot = -Λ e, so that the error decays.",
    _SLIDING_REFERENCE,
    lambda s: s.Lambda,
)  # fmt: skip
DERIVED_REACHES = replace(
    REACHES, form="derived", source="derived here from V = S' S/2 along the closed loop"
)
DERIVED_SLIDES = replace(SLIDES, form="derived", source="derived here: S = 0 means q_dot = Λ (q_d - q)")
LAYER_WIDTH = Condition(
    "width", "derived", "width > 0", "width ≻ 0",
    "Inside the layer S_dot = -(K_Z/width) S: on the exact model S decays to zero.",
    "derived here from V = S' S/2; Slotine and Li (1991), chapter 7",
    lambda s: s.width,
)  # fmt: skip
TWISTING_ROOT = Condition(
    "K_1", "derived", "K_1 > 0", "K_1 ≻ 0",
    "V = K_2 |S| + twist²/2 has V_dot = -K_1 K_2 √|S|; bounds on disturbances are not certified.",
    "derived here; finite time: Levant (1993)",
    lambda s: s.K_1,
)  # fmt: skip
TWIST = Condition(
    "K_2", "derived", "K_2 > 0", "K_2 ≻ 0",
    "V = K_2 |S| + twist²/2 is positive everywhere but at S = twist = 0.",
    "derived here; finite time: Levant (1993)",
    lambda s: s.K_2,
)  # fmt: skip

CONDITIONS: dict[str, tuple[Condition, ...]] = {
    "pd": (PD_SPRING, PD_DAMPER, replace(PD_SPRING, form="derived", source=_PD_SOURCE), DERIVED_PD_DAMPER),
    "pid": (
        *(PRINTED_DAMPER, PRINTED_INTEGRAL, PRINTED_SPRING, PRINTED_LAST),
        *(UNITS_DAMPER, replace(PRINTED_INTEGRAL, form="units", source=_UNITS), UNITS_SPRING, UNITS_LAST),
        replace(PRINTED_INTEGRAL, form="derived", source=_PID_SOURCE),
        *(POSITIVE_CANDIDATE, FALLING_CANDIDATE, SOME_IOTA, ROUTH),
    ),
    "sliding-mode": (REACHES, SLIDES, DERIVED_REACHES, DERIVED_SLIDES),
    "sliding-mode-boundary-layer": (DERIVED_REACHES, DERIVED_SLIDES, LAYER_WIDTH),
    "super-twisting": (TWISTING_ROOT, TWIST, DERIVED_SLIDES),
}
"""Conditions by the id of the law, in the order in which they are shown."""


# --- Lyapunov candidates, their derivatives along the closed loop, and LaSalle's sets --------------
IOTA = symbol("iota")


@dataclass(frozen=True)
class ComparisonSettings:
    """How the stated derivative of a candidate is compared with the one worked out from the model."""

    seed: int = 20210405
    points: int = 3  # at least so many random points, and one for each set of signs
    sizes: tuple[float, float] = (0.2, 1.2)  # of all numbers at these points, SI: none is near zero
    tolerance: float = 1e-9  # relative difference that counts as rounding
    least: float = 1e-12  # of derivatives whose difference is relative to them, SI


COMPARISON = ComparisonSettings()


class Candidate(abc.ABC):
    """A Lyapunov candidate and what its derivative is said to be.

    Errors are q~ = q_d - q as in the paper, so that the integral of a PID law is that of q~.
    """

    V: ClassVar[str]
    V_dot: ClassVar[str]
    equation: ClassVar[str]  # what they are in the paper
    zero_set: ClassVar[str]  # where V_dot is zero
    invariant: ClassVar[str]  # the largest invariant subset of it, if every axis is pushed

    @abc.abstractmethod
    def value(self, s: LawSignals) -> sm.Expr:
        """The candidate."""

    @abc.abstractmethod
    def derivative(self, s: LawSignals) -> sm.Expr:
        """What its derivative along the closed loop is said to be."""


class _PD(Candidate):
    V = "nu' M nu/2 + q~' K_P q~/2"
    V_dot = "-nu' J' K_V J nu - nu' D nu"
    equation = "(24) and (25)"
    zero_set = "nu = 0 with any q~ (the paper prints q~ = 0 as well, which is the invariant subset)"
    invariant = "q~ = 0, nu = 0: elsewhere K_P q~ sets the vehicle in motion"

    def value(self, s: LawSignals) -> sm.Expr:
        return _quadratic_form(s.plant.nu, s.plant.M) / 2 + _quadratic_form(s.error, s.K_P) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        rate = s.plant.J * s.plant.nu
        return -_quadratic_form(rate, s.K_V) - _quadratic_form(s.plant.nu, s.plant.D)


class _PID(_PD):
    V = "nu' M nu/2 + q~' K_P q~/2 - iota q~' M_q q_dot + phi' K_I q~ + iota phi' K_I phi/2"
    V_dot = (
        "-q~' (iota K_P - K_I) q~ + iota q~' K q_dot - q_dot' (K - iota M_q) q_dot - iota q~' C_q' q_dot, "
        "K = K_V + D_q, phi_dot = q~"
    )
    equation = "half of the candidate after (33) with q for q - q_d and the integral of q - q_d for phi"
    zero_set = "q~ = 0, nu = 0 with any phi, where the conditions on V_dot hold"
    invariant = "q~ = 0, nu = 0, phi = 0: elsewhere K_I phi sets the vehicle in motion"

    def value(self, s: LawSignals) -> sm.Expr:
        momentum = s.plant.J_inverse.T * s.plant.M * s.plant.nu
        cross = -IOTA * (s.error.T * momentum)[0] + (s.states.T * s.K_I * s.error)[0]
        return super().value(s) + cross + IOTA * _quadratic_form(s.states, s.K_I) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        """As stated, of q_dot = J nu and q~ = J b: b' D nu is q~' D_q q_dot, and so on, in fewer terms."""
        plant = s.plant
        rate, body = plant.J * plant.nu, plant.J_inverse * s.error
        spring = _quadratic_form(s.error, IOTA * s.K_P - s.K_I)
        motion = _quadratic_form(rate, s.K_V) + _quadratic_form(plant.nu, plant.D - IOTA * plant.M)
        coriolis = plant.C * body - plant.M * (plant.J_inverse * (plant.J_dot * body))  # J' C_q q~
        cross = (s.error.T * s.K_V * rate)[0] + (body.T * plant.D * plant.nu)[0] - (plant.nu.T * coriolis)[0]
        return -spring + IOTA * cross - motion


class _Sliding(Candidate):
    V = "S' S/2"
    V_dot = "-sum K_Z |S|"
    equation = "(38) and (39)"
    zero_set = "S = 0"
    invariant = (
        "S = 0 (an invariant set, not an initial condition); there q~_dot = -Lambda q~, so q~ = 0 in the end"
    )

    def value(self, s: LawSignals) -> sm.Expr:
        return _quadratic_form(sliding_surface(s), sm.eye(len(s.error))) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        return -sum((s.K_Z * sliding_surface(s).applyfunc(sm.Abs)), sm.Integer(0))


class _Layer(_Sliding):
    V_dot = "-sum K_Z |S| min(1, |S|/width)"
    equation = "(39), with a boundary layer"

    def derivative(self, s: LawSignals) -> sm.Expr:
        size = sliding_surface(s).applyfunc(sm.Abs)
        share = (s.width.inv() * size).applyfunc(lambda e: sm.Min(1, e))
        return -(size.T * s.K_Z * share)[0]


class _Twisting(_Sliding):
    V = "sum K_2 |S| + twist' twist/2"
    V_dot = "-sum K_1 K_2 sqrt|S|"
    equation = "none of the paper's"
    zero_set = "S = 0 with any twist"
    invariant = "S = 0, twist = 0: elsewhere S_dot = -twist leads away from S = 0"

    def value(self, s: LawSignals) -> sm.Expr:
        size = sliding_surface(s).applyfunc(sm.Abs)
        return sum(s.K_2 * size, sm.Integer(0)) + _quadratic_form(s.states, sm.eye(len(s.states))) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        root = sliding_surface(s).applyfunc(lambda e: sm.sqrt(sm.Abs(e)))
        return -sum(s.K_1 * s.K_2 * root, sm.Integer(0))


CANDIDATES: dict[str, Candidate] = {
    "pd": _PD(),
    "pid": _PID(),
    "sliding-mode": _Sliding(),
    "sliding-mode-boundary-layer": _Layer(),
    "super-twisting": _Twisting(),
}
"""The candidate of each law."""


def _quadratic_form(x: sm.Matrix, matrix: sm.Matrix) -> sm.Expr:
    return (x.T * matrix * x)[0]


def derivative_parts(value: sm.Expr, law: Law, s: LawSignals) -> tuple[sm.Expr, sm.Matrix, sm.Matrix]:
    """The derivative along the loop but for accelerations, the slope in the velocities, and M nu_dot.

    The law gets the force it asks for; the sign of a velocity that switches parameters counts as constant.
    """
    plant = s.plant
    rate = plant.J * plant.nu
    net = law.force(s) - (plant.C + plant.D) * plant.nu - plant.g
    rates = [
        *zip(plant.eta, rate, strict=True),
        *zip(s.error, -rate, strict=True),
        *zip(s.states, law.rates(s), strict=True),
    ]
    moved = sum((value.diff(x) * v for x, v in rates), sm.Integer(0))
    return moved, sm.Matrix([[value.diff(x) for x in plant.nu]]), net


def derivative_difference(plant: Plant, law: Law) -> float:
    """Largest relative difference of a candidate's derivative from what it is said to be, in every sign set.

    Points are random, with random signs of pose, error and motion; gains are positive.
    """
    s, candidate = LawSignals(numeric_plant(plant), law), CANDIDATES[law.id]
    moved, slope, net = derivative_parts(candidate.value(s), law, s)
    parts = (sm.Matrix([moved, candidate.derivative(s)]), slope, s.plant.M, net)
    names = sorted(set().union(*(part.free_symbols for part in parts)), key=str)
    function = function_of(names, [part.tolist() for part in parts])
    signed = {*plant.eta, *plant.nu, *s.error, *s.states}
    random, worst = Random(COMPARISON.seed), 0.0
    for switches in _sign_combinations(plant):
        signs = {x: random.choice((-1.0, 1.0)) if x in signed else 1.0 for x in names} | switches
        values = {x: signs[x] * random.uniform(*COMPARISON.sizes) for x in names}
        values |= {_sign_symbol(v): sign for v, sign in switches.items()}
        (moved, stated), slope, M, net = map(np.array, function(*(values[x] for x in names)))
        one, other = float(moved[0] + (slope @ np.linalg.solve(M, net))[0, 0]), float(stated[0])
        worst = max(worst, abs(one - other) / max(abs(one), abs(other), COMPARISON.least))
    return worst


def _sign_combinations(plant: Plant) -> list[dict[sm.Symbol, float]]:
    """Signs of the velocities that switch parameters: all of them, and some points at least."""
    combinations = [
        dict(zip(plant.reversing, w, strict=True)) for w in product((1.0, -1.0), repeat=len(plant.reversing))
    ]
    return combinations * max(1, -(-COMPARISON.points // len(combinations)))


def _sign_symbol(velocity: sm.Symbol) -> sm.Symbol:
    """The sign of a velocity as a number of its own, so that it counts as constant."""
    return symbol(f"sign_{velocity}")


@dataclass(frozen=True)
class Lyapunov:
    """A Lyapunov candidate and what the model says of it."""

    V: str
    V_dot: str  # along the closed loop
    equation: str  # what it is in the paper
    identity: str  # how V_dot was compared with the derivative worked out from the model, with what result
    zero_set: str  # where V_dot is zero
    invariant: str  # its largest invariant subset (LaSalle)


def lyapunov(plant: Plant, law: Law, equilibria: str) -> Lyapunov:
    """The candidate of a law with the comparison, and the equilibria of what is not pushed."""
    candidate = CANDIDATES[law.id]
    difference = derivative_difference(plant, law)
    agrees = "equal" if difference < COMPARISON.tolerance else "NOT equal"
    points = f"{len(_sign_combinations(plant))} random points, {difference:.0e} apart"
    return Lyapunov(
        candidate.V,
        candidate.V_dot,
        candidate.equation,
        f"{agrees} to V_dot worked out from the model ({points})",
        candidate.zero_set,
        equilibria or candidate.invariant,
    )


class _SubstitutedPlant:
    def __init__(self, plant: Plant, *values: Mapping[sm.Expr, sm.Expr]) -> None:
        self._plant, self._values = plant, values

    def __getattr__(self, name: str) -> sm.Matrix:
        found = getattr(self._plant, name)
        return (
            reduce(lambda m, v: m.xreplace(v), self._values, found) if hasattr(found, "xreplace") else found
        )


def substituted(plant: Plant, *values: Mapping[sm.Expr, sm.Expr]) -> Plant:
    """A plant whose matrices have values put in for symbols, one mapping after another."""
    return cast(Plant, _SubstitutedPlant(plant, *values))


def numeric_plant(plant: Plant) -> Plant:
    """A plant with numbers for the parameters, and symbols for the signs that switch them."""
    switches = {sm.sign(v): _sign_symbol(v) for v in plant.reversing}
    return substituted(plant, switches, plant.numbers)


def equilibria_without_thrust(plant: Plant, law: Law) -> str:
    """Where the loop comes to rest beside the set-point because no thruster pushes, or nothing.

    At rest the force beyond weight is J' w with w = K_P q~ (and K_I phi); it is zero in every pushed axis for
    w along J^-T times the axes that nothing pushes.
    """
    if not plant.unactuated:
        return ""
    dofs, coordinates = plant.vehicle.degrees_of_freedom, plant.vehicle.pose_names
    lacking = ", ".join(dofs[i] for i in plant.unactuated)
    if "K_P" not in [g.name for g in type(law).gains]:
        return f"not only S = 0: nothing drives S to zero along {lacking}, which no thruster pushes"
    lines = []
    for column in (plant.J_inverse.T[:, i] for i in plant.unactuated):
        parts = ", ".join(f"{c}: {v}" for c, v in zip(coordinates, column, strict=True) if v != 0)
        lines.append(f"({parts})")
    return (
        f"not only q~ = 0: at rest with K_P q~ along {' and '.join(lines)} nothing moves, because no "
        f"thruster acts in {lacking}; that error is never corrected"
    )
