"""The conditions on the gains of every law: PD, PID, sliding modes."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import sympy as sm

from .attitude import block, least_eigenvalue

FORMS = {
    "printed": "as the mini-AUV paper prints them",
    "units": "the printed ones with units that fit (ι in 1/s)",
    "derived": "derived from the model itself",
}
"""Where a condition comes from."""


class Signs:
    """What a condition may use: gains by name, M, D and iota, as symbols, numbers, matrices or intervals.

    Parameters
    ----------
    quantities : mapping
        Value by name.
    """

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
        if isinstance(value, sm.Basic):
            return value
        return np.swapaxes(value, -1, -2) if isinstance(value, np.ndarray) else value.T


class Condition(abc.ABC):
    """A demand `left > right` on gains.

    For a given iota the left side is concave and the right side convex in M and D together, so that over
    a box or a polytope of parameters the margin is least at a corner; it is concave in every single gain and
    in iota, too, so that the values that satisfy it are an interval.

    Attributes
    ----------
    id : str
        Short name.
    form : str
        One of `FORMS`.
    statement : str
        The demand on one channel, as text.
    matrices : str
        The demand on matrices in the paper's notation: eigenvalues that are compared (λmin, λmax), or a
        matrix that is positive definite (≻ 0); nothing where it is stated for one channel only.
    about : str
        What it is for, one sentence.
    source : str
        Where it is from.
    eigenvalues : bool
        Whether it compares the smallest eigenvalue of the left with the largest of the right side; otherwise
        the difference has to be positive definite.
    uses_iota : bool
        Whether it contains iota.
    per_channel_only : bool
        Whether it is stated for one channel (a scalar) and not for matrices.
    matrix_only : bool
        Whether a channel by itself adds nothing to what the matrices say.
    uses : tuple of str
        Which of M and D it contains.
    """

    id: ClassVar[str]
    form: ClassVar[str]
    statement: ClassVar[str]
    matrices: ClassVar[str] = ""
    about: ClassVar[str]
    source: ClassVar[str]
    eigenvalues: ClassVar[bool] = False
    uses_iota: ClassVar[bool] = False
    per_channel_only: ClassVar[bool] = False
    matrix_only: ClassVar[bool] = False
    uses: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def left(self, s: Signs) -> Any:
        """What has to be the larger side."""

    def right(self, s: Signs) -> Any:
        """What has to be the smaller side; zero unless stated."""
        return 0.0 * self.left(s)

    def margin(self, s: Signs) -> Any:
        """How far the condition is from failing; a lower bound of it where the quantities are intervals."""
        left, right = self.left(s), self.right(s)
        if self.eigenvalues:
            return least_eigenvalue(left) + least_eigenvalue(-right)
        return least_eigenvalue(left - right)

    def sides(self, s: Signs) -> tuple[float, float]:
        """Smallest eigenvalue of the left and largest of the right side."""
        return float(least_eigenvalue(self.left(s))), -float(least_eigenvalue(-self.right(s)))


_OWN = "derived here from V = q_dot' M q_dot/2 + e' K_P e/2 along the closed loop"


class PositiveSpring(Condition):
    id = "K_P"
    form = "printed"
    statement = "K_P > 0"
    matrices = "K_P ≻ 0"
    about = "The Lyapunov function (24) is positive, so that the set-point is its lowest place."
    source = "mini-AUV paper (2021), text of (20)"

    def left(self, s: Signs) -> Any:
        return s.K_P


class PositiveDamper(Condition):
    id = "K_V"
    form = "printed"
    statement = "K_V > 0"
    matrices = "K_V ≻ 0"
    about = "The law itself takes energy from every motion, as the paper demands it for (25)."
    source = "mini-AUV paper (2021), text of (20) and (25)"

    def left(self, s: Signs) -> Any:
        return s.K_V


class DampedMotion(Condition):
    id = "K_V + D"
    form = "derived"
    statement = "K_V + D > 0"
    matrices = "K_V + D_q ≻ 0"
    about = "Law and water together take energy from every motion; V_dot = -q_dot' (K_V + D_q) q_dot."
    source = _OWN
    uses = ("D",)

    def left(self, s: Signs) -> Any:
        return s.K_V + s.D


class Spring(PositiveSpring):
    form = "derived"
    source = _OWN


_PAPER = "mini-AUV paper (2021), text between (33) and (34)"
_MENDED = f"{_PAPER}, with units mended"
_PID_OWN = "derived here from V and V_dot along the closed loop"


class PrintedDamper(Condition):
    id = "K_V"
    form = "printed"
    statement = "K_V > M"
    matrices = "λmin(K_V) > λmax(M_q)"
    about = "The paper asks the damping gains to exceed the inertia, though kg/s and kg cannot be compared."
    source = _PAPER
    uses = ("M",)
    eigenvalues = True

    def left(self, s: Signs) -> Any:
        return s.K_V

    def right(self, s: Signs) -> Any:
        return s.M


class PrintedIntegral(Condition):
    id = "K_I"
    form = "printed"
    statement = "K_I > 0"
    matrices = "K_I ≻ 0"
    about = "The integral pushes towards the set-point."
    source = _PAPER

    def left(self, s: Signs) -> Any:
        return s.K_I


class PrintedSpring(Condition):
    id = "K_P"
    form = "printed"
    statement = "K_P > K_V + 2 K_I/ι"
    matrices = "λmin(K_P) > λmax(K_V + 2 K_I/ι)"
    about = "The spring outweighs damper and integral; the smallest gain of all axes against the largest."
    source = _PAPER
    eigenvalues = True
    uses_iota = True

    def left(self, s: Signs) -> Any:
        return s.K_P

    def right(self, s: Signs) -> Any:
        return s.K_V + 2 * s.K_I / s.iota


class PrintedLast(Condition):
    id = "last"
    form = "printed"
    statement = "(1 - ι) K_P/2 > ι M"
    matrices = "(1 - ι) K_P/2 - ι M_q ≻ 0"
    about = "The block of the velocities in V_dot at the set-point; K_V must be meant where K_P is printed."
    source = _PAPER
    uses = ("M",)
    uses_iota = True

    def left(self, s: Signs) -> Any:
        return (1 - s.iota) * s.K_P / 2

    def right(self, s: Signs) -> Any:
        return s.iota * s.M


class MendedDamper(PrintedDamper):
    form = "units"
    statement = "K_V > ι M"
    matrices = "λmin(K_V) > λmax(ι M_q)"
    about = "Damping gains exceed inertia times ι, both in kg/s."
    source = _MENDED
    uses_iota = True

    def right(self, s: Signs) -> Any:
        return s.iota * s.M


class MendedIntegral(PrintedIntegral):
    form = "units"
    source = _MENDED


class MendedSpring(PrintedSpring):
    form = "units"
    statement = "K_P > ι K_V + 2 K_I/ι"
    matrices = "λmin(K_P) > λmax(ι K_V + 2 K_I/ι)"
    about = "The spring outweighs damper and integral, all in N/m."
    source = _MENDED

    def right(self, s: Signs) -> Any:
        return s.iota * s.K_V + 2 * s.K_I / s.iota


class MendedLast(PrintedLast):
    """iota e' K q_dot is at most iota^2 e' K e/2 + q_dot' K q_dot/2, which leaves half of K_V here."""

    form = "units"
    statement = "K_V/2 > ι M"
    matrices = "K_V/2 - ι M_q ≻ 0"
    about = "The block of the velocities in V_dot with K_V in it, both sides in kg/s."
    source = _MENDED

    def left(self, s: Signs) -> Any:
        return s.K_V / 2


class Integral(PrintedIntegral):
    form = "derived"
    source = _PID_OWN


class PositiveCandidate(Condition):
    id = "V"
    form = "derived"
    statement = "K_P - K_I/ι > ι² M"
    matrices = "K_P - K_I/ι - ι² M_q ≻ 0"
    about = "The Lyapunov function is positive everywhere but at the set-point."
    source = _PID_OWN
    uses = ("M",)
    uses_iota = True

    def left(self, s: Signs) -> Any:
        return s.K_P - s.K_I / s.iota

    def right(self, s: Signs) -> Any:
        return s.iota**2 * s.M


class FallingCandidate(Condition):
    id = "V_dot"
    form = "derived"
    statement = "Q(ι) ≻ 0"
    matrices = statement
    about = (
        "The Lyapunov function falls along every motion near the set-point; "
        "Q = [[ι K_P - K_I, ι K/2], [ι K/2, K - ι M_q]] with K = K_V + D_q."
    )
    source = _PID_OWN
    uses = ("M", "D")
    uses_iota = True

    def left(self, s: Signs) -> Any:
        K = s.K_V + s.D
        cross = s.iota * K / 2
        return s.block([[s.iota * s.K_P - s.K_I, cross], [s.transposed(cross), K - s.iota * s.M]])


class SomeIota(Condition):
    """The determinant of the block is a parabola in iota with discriminant (K k_p - M k_i)^2 - k_i K^3.

    Where it is positive, V is as well: K^2/4 >= iota M (K - iota M) always.
    """

    id = "some iota"
    form = "derived"
    statement = "K k_p - M k_i > K √(K k_i), K = k_v + d"
    about = "Exactly then some ι makes the Lyapunov function of this channel work."
    source = _PID_OWN
    uses = ("M", "D")
    per_channel_only = True

    def left(self, s: Signs) -> Any:
        return (s.K_V + s.D) * s.K_P - s.M * s.K_I

    def right(self, s: Signs) -> Any:
        K = s.K_V + s.D
        return K * s.root(K * s.K_I)


class Routh(Condition):
    id = "Routh"
    form = "derived"
    statement = "K k_p > M k_i, K = k_v + d"
    about = "Exactly then the channel, linearised at rest, is stable (Routh-Hurwitz)."
    source = "Routh-Hurwitz criterion on M s^3 + K s^2 + k_p s + k_i"
    uses = ("M", "D")
    per_channel_only = True

    def left(self, s: Signs) -> Any:
        return (s.K_V + s.D) * s.K_P

    def right(self, s: Signs) -> Any:
        return s.M * s.K_I


_SLIDING_PAPER = "mini-AUV paper (2021), text of (34) and (35)"


class Reaches(Condition):
    id = "K_Z"
    form = "printed"
    statement = "K_Z > 0"
    matrices = "K_Z ≻ 0"
    about = "S' S_dot = -sum K_Z |S| is negative: the surface is reached in the time |S|/K_Z."
    source = _SLIDING_PAPER

    def left(self, s: Signs) -> Any:
        return s.K_Z


class Slides(Condition):
    id = "Lambda"
    form = "printed"
    statement = "Λ > 0"
    matrices = "Λ ≻ 0"
    about = "On the surface e_dot = -Λ e, so that the error dies out."
    source = _SLIDING_PAPER

    def left(self, s: Signs) -> Any:
        return s.Lambda


class DerivedSlides(Slides):
    form = "derived"
    source = "derived here: S = 0 means q_dot = Λ (q_d - q)"


class DerivedReaches(Reaches):
    form = "derived"
    source = "derived here from V = S' S/2 along the closed loop"


class HasWidth(Condition):
    id = "width"
    form = "derived"
    statement = "width > 0"
    matrices = "width ≻ 0"
    about = (
        "Inside the layer S_dot = -(K_Z/width) S: S dies out, so on the exact model nothing is left of it."
    )
    source = "derived here from V = S' S/2; Slotine and Li (1991), chapter 7"

    def left(self, s: Signs) -> Any:
        return s.width


class Root(Condition):
    id = "K_1"
    form = "derived"
    statement = "K_1 > 0"
    matrices = "K_1 ≻ 0"
    about = "V = K_2 |S| + twist²/2 has V_dot = -K_1 K_2 √|S|; bounds on disturbances are not certified."
    source = "derived here; finite time: Levant (1993)"

    def left(self, s: Signs) -> Any:
        return s.K_1


class Twist(Root):
    id = "K_2"
    statement = "K_2 > 0"
    matrices = "K_2 ≻ 0"
    about = "V = K_2 |S| + twist²/2 is positive everywhere but at S = twist = 0."

    def left(self, s: Signs) -> Any:
        return s.K_2


CONDITIONS: dict[str, tuple[Condition, ...]] = {
    "pd": (PositiveSpring(), PositiveDamper(), Spring(), DampedMotion()),
    "pid": (
        *(PrintedDamper(), PrintedIntegral(), PrintedSpring(), PrintedLast()),
        *(MendedDamper(), MendedIntegral(), MendedSpring(), MendedLast()),
        *(Integral(), PositiveCandidate(), FallingCandidate(), SomeIota(), Routh()),
    ),
    "sliding-mode": (
        *(Reaches(), Slides()),
        *(DerivedReaches(), DerivedSlides()),
    ),
    "sliding-mode-boundary-layer": (DerivedReaches(), DerivedSlides(), HasWidth()),
    "super-twisting": (Root(), Twist(), DerivedSlides()),
}
"""Conditions by the id of the law, in the order in which they are shown."""
