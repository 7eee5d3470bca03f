"""Buoyancy that does not equal the weight."""

from collections.abc import Iterator, Mapping, Set

import sympy as sm

from undertow.model.effect import Limits, Parameter, Signals, Wrench
from undertow.model.symbols import rotation


class NetBuoyancy(Wrench):
    """Buoyancy in excess of the weight, upward, through the body origin (poor ballasting, water density).

    Where the log has what a ballast tank or a buoyancy engine gives, in N, it is an input.
    """

    id = "net_buoyancy"
    family = "statics"
    reference = "Fossen (2021), chapter 4 (hydrostatics of submerged vehicles, W - B)"
    signature = "a steady vertical command is needed to hold depth, turning with roll and pitch"

    B_net = Parameter("N", "buoyancy minus weight, positive up", logged=True, per_run=True)

    def wrench(self, s: Signals) -> sm.Matrix:
        upward = rotation(sm.Matrix(s.eta[3:])).T * sm.Matrix([0, 0, -self.B_net])
        return sm.Matrix([*upward, 0, 0, 0])

    @classmethod
    def impossible(
        cls, values: Mapping[str, float], limits: Limits, moved: Set[str] = frozenset()
    ) -> Iterator[str]:
        surplus, most = values.get("B_net", 0.0), (limits.buoyancy - 1) * values.get("m", 0.0) * values["g"]
        if most and abs(surplus) > most and "B_net" not in moved:
            yield (
                f"B_net = {surplus:g} N is impossible for a vehicle that weighs "
                f"{values['m'] * values['g']:.4g} N (possible: up to {most:.4g} N either way): correct it "
                "or its unit"
            )
