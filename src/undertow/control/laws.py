"""Control laws, each declared once as expressions of a vehicle's M, C, D, g and J."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import sympy as sm

from undertow.control.plant import Plant
from undertow.model.symbols import POSE, symbol


@dataclass(frozen=True)
class GainMatrix:
    """A diagonal matrix of gains, one for each pose coordinate."""

    name: str  # in gain files, such as K_P
    force: str  # unit for a position (x, y, z)
    moment: str  # unit for an angle (phi, theta, psi); radians are left out
    meaning: str  # what it multiplies

    def unit(self, coordinate: str) -> str:
        """Unit of the gain of a pose coordinate."""
        return self.force if POSE.index(coordinate) < 3 else self.moment

    def symbol(self, coordinate: str) -> sm.Symbol:
        """Symbol of the gain of a pose coordinate, such as K_P_x."""
        return symbol(f"{self.name}_{coordinate}")


class LawSignals:
    """What a law may use, in the n degrees of freedom of a plant; gains and states of the law become symbols.

    `error` is desired less present pose, m and rad, angles within half a turn; `states` are the law's own,
    one block of n for each; `nu_r` and `nu_r_dot` the reference velocity and its rate in the body frame (J
    nu_r is the rate of the desired pose), zero for a set-point, symbols where `moving`. All are columns.
    """

    def __init__(self, plant: Plant, law: Law, moving: bool = False) -> None:
        self.plant, self._law = plant, law
        self.nu_r, self.nu_r_dot = (
            sm.Matrix([symbol(f"{name}_{v}") for v in plant.nu]) if moving else sm.zeros(len(plant.nu), 1)
            for name in ("nu_r", "nu_r_dot")
        )
        self.coordinates = tuple(str(q) for q in plant.eta)
        self.error = sm.Matrix([symbol(f"error_{c}") for c in self.coordinates])
        self.states = sm.Matrix([symbol(n) for n in law.state_names(self.coordinates)])

    def __getattr__(self, name: str) -> sm.Matrix:
        """A gain matrix by its name, diagonal, shape (n, n)."""
        found = [g for g in type(self._law).gains if g.name == name]
        if not found:
            raise AttributeError(f"law '{self._law.id}' declares no gain '{name}'")
        return sm.diag(*[found[0].symbol(c) for c in self.coordinates])


class Law(abc.ABC):
    """A law that drives the pose to a set-point, or along a reference that moves.

    The reference enters by its velocity nu_r and that one's rate, with the feed-forward
    M nu_r_dot + C nu_r + D nu_r + g of the model; a set-point is the reference with nu_r = 0.
    """

    id: ClassVar[str]  # name in gain files
    reference: ClassVar[str]  # where it is from
    gains: ClassVar[tuple[GainMatrix, ...]]  # its gain matrices
    # names of its own states; each is one number for every pose coordinate
    states: ClassVar[tuple[str, ...]] = ()
    offset_order: ClassVar[int] = 1  # power of the sampling interval with which `offset` grows

    @abc.abstractmethod
    def force(self, s: LawSignals) -> sm.Matrix:
        """Generalised force that the law asks for, body frame, shape (n, 1), N and N m."""

    def rates(self, s: LawSignals) -> sm.Matrix:
        """Time derivative of the law's states, shape (n_states * n, 1)."""
        return sm.zeros(len(s.states), 1)

    def offset(self, s: LawSignals) -> sm.Matrix:
        """Distance from the set-point that sampling the law may leave, by estimate, shape (n, 1).

        In m and rad, divided by the interval in s to the power of `offset_order`; zero for continuous laws.
        """
        return sm.zeros(len(s.coordinates), 1)

    @classmethod
    def state_names(cls, coordinates: tuple[str, ...]) -> list[str]:
        """Names of the states for these pose coordinates, such as integral_x."""
        return [f"{name}_{c}" for name in cls.states for c in coordinates]


K_P = GainMatrix("K_P", "N/m", "N m", "position error")
K_V = GainMatrix("K_V", "N s/m", "N m s", "velocity")


class PD(Law):
    """PD control with gravity compensation: a spring to the set-point, a damper, and the weight in water.

    The force in pose coordinates is K_P error - K_V q_dot + g_q; with J' it becomes one in body axes, because
    power is the same in both. On a reference K_V works on J (nu_r - nu), and the feed-forward is added.
    """

    id = "pd"
    reference = "mini-AUV paper (2021), (20) and (21)"
    gains: ClassVar[tuple[GainMatrix, ...]] = (K_P, K_V)

    def force(self, s: LawSignals) -> sm.Matrix:
        plant = s.plant
        at_rest = plant.J.T * (s.K_P * s.error - s.K_V * plant.J * plant.nu) + plant.g
        return at_rest + plant.J.T * s.K_V * plant.J * s.nu_r + feed_forward(s)


def feed_forward(s: LawSignals) -> sm.Matrix:
    """Force beyond the weight to keep the model on its reference: M nu_r_dot + (C + D) nu_r, shape (n, 1)."""
    plant = s.plant
    return plant.M * s.nu_r_dot + (plant.C + plant.D) * s.nu_r


K_I = GainMatrix("K_I", "N/(m s)", "N m/s", "integral of the position error")


class PID(PD):
    """PID control with gravity compensation: the PD law and an integral of the error in pose coordinates."""

    id = "pid"
    reference = "mini-AUV paper (2021), (26) and (27)"
    gains = (*PD.gains, K_I)
    states = ("integral",)

    def force(self, s: LawSignals) -> sm.Matrix:
        return super().force(s) + s.plant.J.T * s.K_I * s.states

    def rates(self, s: LawSignals) -> sm.Matrix:
        return s.error


LAMBDA = GainMatrix("Lambda", "1/s", "1/s", "position error in the sliding surface")
K_Z = GainMatrix("K_Z", "m/s^2", "rad/s^2", "sign of the sliding surface")


def sliding_surface(s: LawSignals) -> sm.Matrix:
    """The surface S = J (nu_r - nu) + Lambda error, shape (n, 1), m/s and rad/s."""
    return -s.plant.J * s.plant.nu + s.Lambda * s.error + s.plant.J * s.nu_r


class _Sliding(Law):
    """A law that makes S = J (nu_r - nu) + Lambda error obey S_dot = -reach(S) on the plant it knows.

    With q_dot = J nu, S_dot = J_dot (nu_r - nu) + J (nu_r_dot - nu_dot) + Lambda J (nu_r - nu); solved for
    nu_dot and put into the equations of motion this is the force below.
    """

    @abc.abstractmethod
    def reaching_rate(self, s: LawSignals) -> sm.Matrix:
        """How fast S is driven to zero, shape (n, 1), m/s^2 and rad/s^2."""

    def force(self, s: LawSignals) -> sm.Matrix:
        plant = s.plant
        surface_rate = self.reaching_rate(s) - plant.J_dot * plant.nu - s.Lambda * plant.J * plant.nu
        surface_rate += (plant.J_dot + s.Lambda * plant.J) * s.nu_r
        acceleration = plant.J_inverse * surface_rate + s.nu_r_dot
        return plant.M * acceleration + (plant.C + plant.D) * plant.nu + plant.g


def _errors_at_rest(sizes: Sequence[sm.Expr], s: LawSignals) -> sm.Matrix:
    """Errors at rest, where S = Lambda error, of these sizes of S."""
    return sm.Matrix([size / a if a else a for size, a in zip(sizes, s.Lambda.diagonal(), strict=True)])


class SlidingMode(_Sliding):
    """Sliding-mode control: the sign of the surface, which is reached in the time |S| / K_Z."""

    id = "sliding-mode"
    reference = "mini-AUV paper (2021), (34) to (37); its explicit law follows from (9)"
    gains = (K_Z, LAMBDA)

    def reaching_rate(self, s: LawSignals) -> sm.Matrix:
        return s.K_Z * sliding_surface(s).applyfunc(sm.sign)

    def offset(self, s: LawSignals) -> sm.Matrix:
        # A sample takes S at most K_Z dt past zero.
        return _errors_at_rest(s.K_Z.diagonal(), s)


class BoundaryLayer(_Sliding):
    """Sliding-mode control with a boundary layer: linear for |S| below the width, hence no chatter."""

    id = "sliding-mode-boundary-layer"
    reference = "Slotine and Li (1991), Applied Nonlinear Control, chapter 7 (boundary layer)"
    gains = (K_Z, LAMBDA, GainMatrix("width", "m/s", "rad/s", "half the thickness of the layer around S = 0"))

    def reaching_rate(self, s: LawSignals) -> sm.Matrix:
        inside = s.width.inv() * sliding_surface(s)
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

    def reaching_rate(self, s: LawSignals) -> sm.Matrix:
        root = sliding_surface(s).applyfunc(lambda e: sm.sqrt(sm.Abs(e)) * sm.sign(e))
        return s.K_1 * root + s.states

    def rates(self, s: LawSignals) -> sm.Matrix:
        return s.K_2 * sliding_surface(s).applyfunc(sm.sign)

    def offset(self, s: LawSignals) -> sm.Matrix:
        # The root alone takes S past zero where K_1 |S|^(1/2) dt > |S|, so by K_1^2 dt^2. In a sample it
        # takes K_1 K_2 |S|^(1/2) dt of K_2 |S| + twist^2 / 2, to which the sampled sign adds K_2^2 dt^2 / 2:
        # balance is where |S|^(1/2) is of the order of K_2 dt / K_1. Both: (K_1 + K_2 / K_1)^2 dt^2.
        pairs = zip(s.K_1.diagonal(), s.K_2.diagonal(), strict=True)
        return _errors_at_rest([(k_1 + k_2 / k_1) ** 2 for k_1, k_2 in pairs], s)


DISCONTINUOUS = {"sliding-mode": "K_Z", "super-twisting": "K_1"}
"""Laws that are discontinuous at their set-point, and so not linearisable there, with the driving gain."""
LAWS: dict[str, type[Law]] = {cls.id: cls for cls in (PD, PID, SlidingMode, BoundaryLayer, SuperTwisting)}
