"""Thrust lost to the speed of the inflow."""

from math import inf

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench, column
from undertow.model.effects.thrusters import at_rest


class ThrustLoss(Wrench):
    """A thruster that moves in the direction of its thrust loses thrust with speed.

    Included because curves and data sheets give the thrust at rest. A propeller with K_T = K_0 - K_1 J of
    diameter D whose thrust at rest would be F loses D K_1 / sqrt(K_0) sqrt(rho F) v, with v the speed of the
    thruster through the water along its thrust: its column of the allocation times the velocity.
    """

    id = "thrust_loss"
    family = "actuation"
    reference = (
        "Fossen (2021), chapter 9 (thrust from shaft speed and speed of advance, T_nn |n| n - T_nu |n| u)"
    )
    signature = "drag seems larger under thrust than when coasting, by more the larger the thrust"
    requires = ("thrusters",)
    dissipative = True

    inflow_length = Parameter(
        "m", "propeller diameter times K_1 / sqrt(K_0), often near the diameter", (0, inf)
    )
    inflow_least = Parameter.with_default(
        "N", "thrust below which the root is rounded off", (1e-9, 1e3), 1e-3
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        return -self.inflow_length * self.allocation * self._lost

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        roots = at_rest(self, s).applyfunc(lambda force: sm.sqrt(s.rho) * self._root(force))
        speeds = [self._speed(column, s.nu_r) for column in self.allocation.T.tolist()]
        return {x: root * speed for x, root, speed in zip(self._lost, roots, speeds, strict=True)}

    @staticmethod
    def _speed(column: list[sm.Expr], nu_r: sm.Matrix) -> sm.Expr:
        """Speed along the thrust; a column without a direction is a pure moment and no propeller, m/s."""
        return sm.Matrix(column).dot(nu_r) if any(column[:3]) else sm.Integer(0)

    @property
    def _lost(self) -> sm.Matrix:
        """Thrust that is lost per `inflow_length`, shape (n_thrusters, 1), N/m."""
        return column([f"lost_{n}" for n in self.thrusters])

    def _root(self, force: sm.Expr) -> sm.Expr:
        # sqrt(|F|) has no derivative at zero, where commands often are.
        return force**2 / (force**2 + self.inflow_least**2) ** sm.Rational(3, 4)
