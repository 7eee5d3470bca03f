"""Weight and buoyancy with their arms."""

from collections.abc import Iterator, Mapping, Set
from math import inf

import sympy as sm

from undertow.model.effect import Limits, Parameter, SharedQuantity, Signals, Wrench, symbol
from undertow.model.symbols import rotation

_ARMS = {f"{axis}_{point}": "m" for axis in "xyz" for point in "gb"}


def _centre(axis: str) -> SharedQuantity:
    stated, moment = symbol(f"{axis}_g"), symbol(f"m{axis}_g")
    return SharedQuantity(
        f"{axis}_g", "rigid_body", (stated, moment / symbol("m")), "m", unless=(f"S_{axis}",)
    )


class Restoring(Wrench):
    """Weight and buoyancy at their centres: net force and righting moment.

    Inside, the moment is stated by the static moments `S_x` = x_g W - x_b B and so on, which is all that
    motion can show; a vehicle file gives `x_b` ... `z_b`. The weight, m g, and the centre of gravity are
    those of `rigid_body` unless the table states others.
    """

    id = "restoring"
    family = "statics"
    known_by_design = True
    reference = "Fossen (2021), chapter 4 (restoring forces of submerged vehicles)"
    signature = "roll and pitch do not swing back to level, or with the wrong period"

    # Scales and drawings agree to a per cent or two; a factor of two is no tolerance of either.
    shared_quantities = (
        SharedQuantity(
            "W", "rigid_body", (symbol("m") * symbol("g"),), "N", rounding=0.02, most=2.0, words="m g"
        ),
        *(_centre(axis) for axis in "xyz"),
    )

    W = Parameter("N", "weight", (0, inf), required=True)
    B = Parameter("N", "buoyancy", (0, inf), required=True)
    S_x = Parameter("N m", "static moment x_g W - x_b B", default=0.0, arm_of="W")
    S_y = Parameter("N m", "static moment y_g W - y_b B", default=0.0, arm_of="W")
    S_z = Parameter("N m", "static moment z_g W - z_b B", default=0.0, arm_of="W")

    def wrench(self, s: Signals) -> sm.Matrix:
        down = rotation(sm.Matrix(s.eta[3:])).T * sm.Matrix([0, 0, 1])
        moment = sm.Matrix([self.S_x, self.S_y, self.S_z]).cross(down)
        return sm.Matrix([*((self.W - self.B) * down), *moment])

    @classmethod
    def file_units(cls) -> dict[str, str]:
        return _ARMS

    @classmethod
    def from_file(cls, entries: dict[str, float]) -> dict[str, float]:
        base = {k: v for k, v in entries.items() if k not in _ARMS}
        for axis in "xyz":
            weight_arm, buoyancy_arm = entries.get(f"{axis}_g", 0.0), entries.get(f"{axis}_b", 0.0)
            if f"{axis}_g" in entries or f"{axis}_b" in entries:
                base[f"S_{axis}"] = weight_arm * entries.get("W", 0.0) - buoyancy_arm * entries.get("B", 0.0)
        return base

    @classmethod
    def reconciled(cls, values: Mapping[str, float], shared: Mapping[str, float]) -> dict[str, float]:
        """Motion determines only W - B: the weight follows from the mass, the buoyancy from that."""
        if "W" not in shared:
            return dict(values)
        lift = values.get("B", 0.0) - values.get("W", 0.0)
        return {**values, "W": shared["W"], "B": shared["W"] + lift}

    @classmethod
    def impossible(
        cls, values: Mapping[str, float], limits: Limits, moved: Set[str] = frozenset()
    ) -> Iterator[str]:
        weight, most = values.get("W", 0.0), limits.buoyancy
        if weight <= 0:
            yield f"W = {weight:g} N is impossible: every vehicle has a weight; remove W to use m g"
            return
        others = {"m g": values.get("m", weight / values["g"]) * values["g"], "B": values.get("B", 0.0)}
        for name, force in others.items():
            if not weight / most <= force <= weight * most:
                yield (
                    f"{name} = {force:g} N does not fit W = {weight:g} N (possible: {weight / most:.3g} "
                    f"to {weight * most:.3g} N): correct one of them; 1 kg weighs 9.81 N"
                )
