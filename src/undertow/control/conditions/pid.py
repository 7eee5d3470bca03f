"""Conditions on the gains of PID control: as printed, with units that fit, and derived anew.

With e = q - q_d, z the integral of e and K = K_V + D, the closed loop is
M q_ddot + C q_dot + K q_dot + K_P e + K_I z = 0. The candidate

V = q_dot' M q_dot/2 + e' K_P e/2 + iota e' M q_dot + z' K_I e + iota z' K_I z/2

is half of the paper's, and with M_dot = C + C' (power balance)

-V_dot = e' (iota K_P - K_I) e + iota e' K q_dot + q_dot' (K - iota M) q_dot - iota e' C' q_dot.

The last term is of third order: without it the sum is a quadratic form, and its matrix is the condition
below; with it the result holds near the set-point (module `region`). Completing the squares in z and q_dot
leaves K_P - K_I/iota - iota^2 M for V.
"""

from __future__ import annotations

from typing import Any

from .condition import Condition, Signs

_PAPER = "mini-AUV paper (2021), text between (33) and (34)"
_MENDED = f"{_PAPER}, with units mended"
_OWN = "derived here from V and V_dot along the closed loop"


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
    source = _OWN


class PositiveCandidate(Condition):
    id = "V"
    form = "derived"
    statement = "K_P - K_I/ι > ι² M"
    matrices = "K_P - K_I/ι - ι² M_q ≻ 0"
    about = "The Lyapunov function is positive everywhere but at the set-point."
    source = _OWN
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
    source = _OWN
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
    source = _OWN
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
