"""Coulomb friction."""

from math import inf

import sympy as sm

from undertow.model.effect import DIAGONAL, VELOCITY, DerivativeMatrix, Parameter, Signals, Wrench


def _width(unit: str, description: str) -> Parameter:
    """How narrow the smoothed sign is; it is searched for, and does nothing without friction."""
    return Parameter.with_default(unit, description, (1e-4, 0.1), 0.02, starts=(0.005, 0.04), step_width=True)


class DryFriction(Wrench):
    """Friction of constant size against the motion: guides, bearings, a dragging cable on the bottom."""

    id = "dry_friction"
    family = "damping"
    reference = "Coulomb friction, its sign smoothed by tanh; Armstrong-Helouvry et al. (1994), Automatica 30"
    signature = "the vehicle stops dead instead of creeping, and small thrust does not move it"
    dissipative = True

    coefficients = DerivativeMatrix(
        "{F}_sign{m}", ("1", "1"), DIAGONAL, "{force} against {motion}, whatever the speed", bounds=(-inf, 0)
    )
    friction_speed = _width("m/s", "speed at which friction is fully developed")
    friction_rate = _width("rad/s", "the same for rotations")

    def wrench(self, s: Signals) -> sm.Matrix:
        scale = [self.friction_speed if i < 3 else self.friction_rate for i in range(len(VELOCITY))]
        return self.coefficients * sm.Matrix([sm.tanh(v / c) for v, c in zip(s.nu, scale, strict=True)])
