"""Sliding-mode control, with a sign, a boundary layer, or the super-twisting algorithm."""

from __future__ import annotations

import abc
from collections.abc import Sequence

import sympy as sm

from .law import GainMatrix, Law, LawSignals

LAMBDA = GainMatrix("Lambda", "1/s", "1/s", "position error in the sliding surface")
K_Z = GainMatrix("K_Z", "m/s^2", "rad/s^2", "sign of the sliding surface")


class _Sliding(Law):
    """A law that makes S = -q_dot + Lambda error obey S_dot = -reach(S) on the plant it knows.

    With q_dot = J nu and a constant set-point, S_dot = -J_dot nu - J nu_dot - Lambda J nu; solved for nu_dot
    and put into the equations of motion this is the force below.
    """

    def surface(self, s: LawSignals) -> sm.Matrix:
        """The sliding surface S, shape (n, 1), m/s and rad/s."""
        return -s.plant.J * s.plant.nu + s.Lambda * s.error

    @abc.abstractmethod
    def reach(self, s: LawSignals) -> sm.Matrix:
        """How fast S is driven to zero, shape (n, 1), m/s^2 and rad/s^2."""

    def force(self, s: LawSignals) -> sm.Matrix:
        plant = s.plant
        wanted = self.reach(s) - plant.J_dot * plant.nu - s.Lambda * plant.J * plant.nu
        acceleration = plant.J_inverse * wanted
        return plant.M * acceleration + (plant.C + plant.D) * plant.nu + plant.g


def _errors(sizes: Sequence[sm.Expr], s: LawSignals) -> sm.Matrix:
    """Errors at rest, where S = Lambda error, of these sizes of S."""
    return sm.Matrix([size / a if a else a for size, a in zip(sizes, s.Lambda.diagonal(), strict=True)])


class SlidingMode(_Sliding):
    """Sliding-mode control: the sign of the surface, which is reached in the time |S| / K_Z."""

    id = "sliding-mode"
    reference = "mini-AUV paper (2021), (34) to (37); its explicit law follows from (9)"
    gains = (K_Z, LAMBDA)

    def reach(self, s: LawSignals) -> sm.Matrix:
        return s.K_Z * self.surface(s).applyfunc(sm.sign)

    def offset(self, s: LawSignals) -> sm.Matrix:
        # A sample takes S at most K_Z dt past zero.
        return _errors(s.K_Z.diagonal(), s)


class BoundaryLayer(_Sliding):
    """Sliding-mode control with a boundary layer: linear where |S| is below the width, so without chatter."""

    id = "sliding-mode-boundary-layer"
    reference = "Slotine and Li (1991), Applied Nonlinear Control, chapter 7 (boundary layer)"
    gains = (K_Z, LAMBDA, GainMatrix("width", "m/s", "rad/s", "half the thickness of the layer around S = 0"))

    def reach(self, s: LawSignals) -> sm.Matrix:
        inside = s.width.inv() * self.surface(s)
        return s.K_Z * inside.applyfunc(lambda e: sm.Max(-1, sm.Min(1, e)))


class SuperTwisting(_Sliding):
    """Super-twisting control: continuous, learns a constant disturbance, reaches S = 0 in finite time."""

    id = "super-twisting"
    reference = "Levant (1993), Sliding order and sliding accuracy in sliding mode control"
    gains = (
        GainMatrix("K_1", "m/s^2", "rad/s^2", "root of the sliding surface in m/s and rad/s"),
        GainMatrix("K_2", "m/s^3", "rad/s^3", "integral of the sign of the sliding surface"),
        LAMBDA,
    )
    states = ("twist",)
    offset_order = 2

    def reach(self, s: LawSignals) -> sm.Matrix:
        root = self.surface(s).applyfunc(lambda e: sm.sqrt(sm.Abs(e)) * sm.sign(e))
        return s.K_1 * root + s.states

    def rates(self, s: LawSignals) -> sm.Matrix:
        return s.K_2 * self.surface(s).applyfunc(sm.sign)

    def offset(self, s: LawSignals) -> sm.Matrix:
        # The root alone takes S past zero where K_1 |S|^(1/2) dt > |S|, so by K_1^2 dt^2. In a sample it
        # takes K_1 K_2 |S|^(1/2) dt of K_2 |S| + twist^2 / 2, to which the sampled sign adds K_2^2 dt^2 / 2:
        # balance is where |S|^(1/2) is of the order of K_2 dt / K_1. Both: (K_1 + K_2 / K_1)^2 dt^2.
        pairs = zip(s.K_1.diagonal(), s.K_2.diagonal(), strict=True)
        return _errors([(k_1 + k_2 / k_1) ** 2 for k_1, k_2 in pairs], s)
