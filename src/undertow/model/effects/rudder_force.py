"""Force of rudders and fins."""

import sympy as sm

from undertow.model.effect import ACTUATORS, PerThruster, Signals, Wrench


class RudderForce(Wrench):
    """Force per command that grows with the square of the forward speed, as of a rudder, a fin or a flap.

    Included because a vehicle file knows the command of a control surface only as a
    thruster, whose force does not depend on the speed. The force acts along the column that the command has
    in the allocation, and turns round astern. Lift is perpendicular to the inflow: a command that pushes
    along the hull is that of a propeller and has none.
    """

    id = "rudder_force"
    family = "actuation"
    reference = (
        "Fossen (2021), chapter 9 (rudders and fins: lift proportional to the speed squared and the angle)"
    )
    signature = "the same command gives no force at rest and four times as much at twice the speed"

    rudder = PerThruster("N/(m/s)^2/command", "force per command and speed ahead squared")

    def wrench(self, s: Signals) -> sm.Matrix:
        speed, across = s.nu_r[0], [self._is_across(ahead) for ahead in self.allocation[0, :]]
        lift = s.actuation.multiply_elementwise(self.rudder)
        return sm.Abs(speed) * speed * self.allocation * sm.diag(*across) * lift

    @staticmethod
    def _is_across(ahead: sm.Expr) -> int:
        """1 for a command across the hull, or of unknown direction; directions are rounded in files."""
        if not ahead.is_number:
            return int(not ahead.is_nonzero)
        return int(abs(float(ahead)) < ACTUATORS.largest_part_ahead)
