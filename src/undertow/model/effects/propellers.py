"""Propellers by their revolutions."""

from math import inf
from typing import Self

import sympy as sm

from undertow.model.effect import Effect, PerThruster, Propeller, Signals, Wrench, column
from undertow.model.effects.thrusters import at_rest


class Propellers(Wrench):
    """Thrust of propellers whose command is their speed of revolution, in their inflow.

    The thrust coefficient falls linearly with the advance ratio, K_T = K_T0 + K_T1 J, so that the thrust is
    rho D^4 (K_T0 |n| n + K_T1 |n| u_a / D), where u_a is the speed along the shaft that the wake leaves.
    """

    id = "propellers"
    family = "actuation"
    reference = "Fossen (2021), chapter 9 (propeller thrust and torque, K_T linear in the advance ratio)"
    signature = "thrust falls off as the vehicle gathers way at constant revolutions"
    built_in = True

    K_T0 = PerThruster("1", "thrust coefficient at rest", (0, inf))
    K_T1 = PerThruster("1", "change of the thrust coefficient with the advance ratio", (-inf, 0))
    wake_fraction = PerThruster.with_default("1", "wake fraction of the speed ahead", (-1, 1), 0.0)
    thrust_deduction = PerThruster.with_default(
        "1", "share of the thrust lost to added drag of the hull", (-1, 1), 0.0
    )

    @classmethod
    def specimen(cls, inputs: tuple[str, ...] = ()) -> Self:
        there = super().specimen(inputs)
        there.laws = tuple(Propeller.specimen(n) for n in there.thrusters)
        return there

    def wrench(self, s: Signals) -> sm.Matrix:
        return self.allocation * (thrust_of(self, s) - at_rest(self, s))


def thrust_of(effect: Effect, s: Signals) -> sm.Matrix:
    """Thrust of every thruster, shape (n, 1), N."""
    rows = list(at_rest(effect, s))
    for i, law in enumerate(effect.laws):
        if isinstance(law, Propeller):
            speed = effect.allocation[:, i].dot(s.nu_r) if any(effect.allocation[:3, i]) else 0
            rows[i] = _thrust(effect.thrusters[i], law, s, s.actuation[i], speed)
    return sm.Matrix(len(rows), 1, rows)


def _thrust(name: str, law: Propeller, s: Signals, command: sm.Expr, speed: sm.Expr) -> sm.Expr:
    """Thrust of one propeller at a command and a speed along its shaft, N."""
    names = ("K_T0", "K_T1", "wake_fraction", "thrust_deduction")
    static, falling, wake, deduction = column([f"{n}_{name}" for n in names])
    n, advance = law.per_command * command, (1 - wake) * speed
    size = s.rho * law.diameter**4
    return (1 - deduction) * size * sm.Abs(n) * (static * n + falling * advance / law.diameter)
