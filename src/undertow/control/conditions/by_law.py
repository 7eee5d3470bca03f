"""The conditions on the gains of every law: PD, PID, sliding modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sm

from .attitude import block, least_eigenvalue, transposed

FORMS = {
    "printed": "as the mini-AUV paper prints them",
    "units": "the printed ones with units that fit (ι in 1/s)",
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
_FROM_PD_ENERGY = "derived here from V = q_dot' M q_dot/2 + e' K_P e/2 along the closed loop"

PD_SPRING = Condition(
    "K_P", "printed", "K_P > 0", "K_P ≻ 0",
    "The Lyapunov function (24) is positive, so that the set-point is its lowest place.",
    "mini-AUV paper (2021), text of (20)",
    lambda s: s.K_P,
)  # fmt: skip
PD_DAMPER = Condition(
    "K_V", "printed", "K_V > 0", "K_V ≻ 0",
    "The law itself takes energy from every motion, as the paper demands it for (25).",
    "mini-AUV paper (2021), text of (20) and (25)",
    lambda s: s.K_V,
)  # fmt: skip
DERIVED_PD_DAMPER = Condition(
    "K_V + D", "derived", "K_V + D > 0", "K_V + D_q ≻ 0",
    "Law and water together take energy from every motion; V_dot = -q_dot' (K_V + D_q) q_dot.",
    _FROM_PD_ENERGY,
    lambda s: s.K_V + s.D, uses="D",
)  # fmt: skip

# --- PID ------------------------------------------------------------------------------------------
_PAPER = "mini-AUV paper (2021), text between (33) and (34)"
_UNITS = f"{_PAPER}, with units mended"
_FROM_PID_CANDIDATE = "derived here from V and V_dot along the closed loop"

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
    "The block of the velocities in V_dot at the set-point; K_V must be meant where K_P is printed.",
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
    _FROM_PID_CANDIDATE,
    lambda s: s.K_P - s.K_I / s.iota, lambda s: s.iota**2 * s.M, uses="M", uses_iota=True,
)  # fmt: skip


def _minus_candidate_rate(s: Quantities) -> Any:
    K = s.K_V + s.D
    cross = s.iota * K / 2
    return s.block([[s.iota * s.K_P - s.K_I, cross], [s.transposed(cross), K - s.iota * s.M]])


FALLING_CANDIDATE = Condition(
    "V_dot", "derived", "Q(ι) ≻ 0", "Q(ι) ≻ 0",
    "The Lyapunov function falls along every motion near the set-point; "
    "Q = [[ι K_P - K_I, ι K/2], [ι K/2, K - ι M_q]] with K = K_V + D_q.",
    _FROM_PID_CANDIDATE,
    _minus_candidate_rate, uses="MD", uses_iota=True,
)  # fmt: skip
# The determinant of the block is a parabola in iota with discriminant (K k_p - M k_i)^2 - k_i K^3. Where it
# is positive, V is as well: K^2/4 >= iota M (K - iota M) always.
SOME_IOTA = Condition(
    "some iota", "derived", "K k_p - M k_i > K √(K k_i), K = k_v + d", "",
    "Exactly then some ι makes the Lyapunov function of this channel work.",
    _FROM_PID_CANDIDATE,
    lambda s: (s.K_V + s.D) * s.K_P - s.M * s.K_I,
    lambda s: (s.K_V + s.D) * s.root((s.K_V + s.D) * s.K_I), uses="MD",
)  # fmt: skip
ROUTH = Condition(
    "Routh", "derived", "K k_p > M k_i, K = k_v + d", "",
    "Exactly then the channel, linearised at rest, is stable (Routh-Hurwitz).",
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
    "On the surface e_dot = -Λ e, so that the error dies out.",
    _SLIDING_REFERENCE,
    lambda s: s.Lambda,
)  # fmt: skip
DERIVED_REACHES = replace(
    REACHES, form="derived", source="derived here from V = S' S/2 along the closed loop"
)
DERIVED_SLIDES = replace(SLIDES, form="derived", source="derived here: S = 0 means q_dot = Λ (q_d - q)")
LAYER_WIDTH = Condition(
    "width", "derived", "width > 0", "width ≻ 0",
    "Inside the layer S_dot = -(K_Z/width) S: S dies out, so on the exact model nothing is left of it.",
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
    "pd": (
        PD_SPRING,
        PD_DAMPER,
        replace(PD_SPRING, form="derived", source=_FROM_PD_ENERGY),
        DERIVED_PD_DAMPER,
    ),
    "pid": (
        *(PRINTED_DAMPER, PRINTED_INTEGRAL, PRINTED_SPRING, PRINTED_LAST),
        *(UNITS_DAMPER, replace(PRINTED_INTEGRAL, form="units", source=_UNITS), UNITS_SPRING, UNITS_LAST),
        replace(PRINTED_INTEGRAL, form="derived", source=_FROM_PID_CANDIDATE),
        *(POSITIVE_CANDIDATE, FALLING_CANDIDATE, SOME_IOTA, ROUTH),
    ),
    "sliding-mode": (REACHES, SLIDES, DERIVED_REACHES, DERIVED_SLIDES),
    "sliding-mode-boundary-layer": (DERIVED_REACHES, DERIVED_SLIDES, LAYER_WIDTH),
    "super-twisting": (TWISTING_ROOT, TWIST, DERIVED_SLIDES),
}
"""Conditions by the id of the law, in the order in which they are shown."""
