"""Thrust of the vehicle's thrusters."""

from __future__ import annotations

import sympy as sm

from undertow.model.effect import Wrench
from undertow.model.parameter import PerThruster
from undertow.model.symbols import Signals, column


class Thrusters(Wrench):
    """Thrust of every thruster at its place and in its direction (control allocation)."""

    id = "thrusters"
    family = "actuation"
    reference = "Fossen (2021), thruster configuration matrix"
    signature = "no motion in answer to a command"
    built_in = True

    thrust = PerThruster("N/command", "thrust per unit of command", (0, float("inf")))

    def __init__(self, thrusters: tuple[str, ...] = (), allocation: sm.Matrix | None = None) -> None:
        super().__init__(thrusters)
        self.allocation = allocation if allocation is not None else sm.zeros(6, len(thrusters))

    @property
    def constants(self) -> dict[sm.Symbol, str]:
        return {x: "1" if str(x).startswith("e_") else "m" for x in self.allocation.free_symbols}

    @classmethod
    def specimen(cls) -> Thrusters:
        names = ("port", "starboard")
        columns = [[*(f"e_{a}_{n}" for a in "xyz"), *(f"lever_{a}_{n}" for a in "xyz")] for n in names]
        return cls(names, sm.Matrix.hstack(*map(column, columns)))

    def wrench(self, s: Signals) -> sm.Matrix:
        if not self.thrusters:
            return sm.zeros(6, 1)
        return self.allocation * s.actuation.multiply_elementwise(self.thrust)
