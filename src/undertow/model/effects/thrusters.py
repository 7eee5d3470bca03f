"""Thrust of the vehicle's thrusters."""

import sympy as sm

from undertow.model.effect import Curve, Effect, PerThruster, Propeller, Signals, Wrench, column


class Thrusters(Wrench):
    """Thrust of every thruster at its place and in its direction (control allocation).

    It is in proportion to the command, or to what a curve from a test bench gives for it. Propellers whose
    command is their speed of revolution are an effect of their own.
    """

    id = "thrusters"
    family = "actuation"
    reference = "Fossen (2021), thruster configuration matrix"
    signature = "no motion in response to a command"
    built_in = True

    thrust = PerThruster("N/command", "thrust per unit of command", (0, float("inf")))

    def wrench(self, s: Signals) -> sm.Matrix:
        if not self.thrusters:
            return sm.zeros(6, 1)
        return self.allocation * at_rest(self, s)


def at_rest(effect: Effect, s: Signals) -> sm.Matrix:
    """Thrust of every thruster in water at rest, shape (n, 1), N; zero for propellers by revolutions."""
    scales = column([f"thrust_{n}" for n in effect.thrusters])
    rows = []
    for command, scale, law in zip(s.actuation, scales, effect.laws, strict=True):
        shape = law.thrust(command) if isinstance(law, Curve) else command
        rows.append(sm.Integer(0) if isinstance(law, Propeller) else shape * scale)
    return sm.Matrix(len(rows), 1, rows)
