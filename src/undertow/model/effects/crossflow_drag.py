"""Cross-flow drag along the hull."""

from math import inf

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench, column

# Simpson's rule over nine stations: unlike the closed form it does not divide by the yaw rate.
_SIMPSON = sm.Matrix([1, 4, 2, 4, 2, 4, 2, 4, 1])


class CrossflowDrag(Wrench):
    """Drag of every strip of the hull in the cross-flow that it meets: sway with yaw, heave with pitch.

    Included because turning moves bow and stern sideways: one coefficient gives the sway force, the yaw
    moment and how they depend on each other, which diagonal quadratic damping cannot. Strip theory over the
    length L_cross, summed over nine stations by Simpson's rule; without rotation it is `quadratic_damping`.
    """

    id = "crossflow_drag"
    family = "damping"
    reference = (
        "Faltinsen (1990), Sea Loads on Ships and Offshore Structures, chapter 6 (cross-flow principle)"
    )
    signature = "sway drag grows when the vehicle turns, and sideways motion while turning gives a yaw moment"
    scales_with = "drag"
    dissipative = True

    T_cross = Parameter("m", "drag coefficient times mean draught (height of the side)", (0, inf))
    B_cross = Parameter("m", "drag coefficient times mean beam (width of the bottom)", (0, inf))
    L_cross = Parameter.with_starts("m", "length of the hull", (0.05, 500.0), (0.4, 1.5, 6.0, 30.0, 150.0))
    x_cross = Parameter.with_starts("m", "middle of the length, forward", (-100.0, 100.0), (0.0,), arm_of="1")

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        return {"sway", "yaw"} <= set(dofs) or {"heave", "pitch"} <= set(dofs)

    def wrench(self, s: Signals) -> sm.Matrix:
        x, across, down = _stations()
        side, bottom = (-s.rho * self.L_cross * c / (2 * sum(_SIMPSON)) for c in (self.T_cross, self.B_cross))
        sway, heave = (_SIMPSON.multiply_elementwise(c.applyfunc(_square)) for c in (across, down))
        return sm.Matrix(
            [0, side * sum(sway), bottom * sum(heave), 0, -bottom * x.dot(heave), side * x.dot(sway)]
        )

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        _, v, w, _, q, r = s.nu_r
        x, across, down = _stations()
        shares = [sm.Rational(i, len(x) - 1) - sm.Rational(1, 2) for i in range(len(x))]
        places = sm.Matrix([self.x_cross + share * self.L_cross for share in shares])
        meanings = [*places, *x.applyfunc(lambda x: v + x * r), *x.applyfunc(lambda x: w - x * q)]
        return dict(zip([*x, *across, *down], meanings, strict=True))


def _stations() -> list[sm.Matrix]:
    """Symbols of the stations' places and of the cross-flow there, to starboard and down."""
    return [column([f"{name}_{i + 1}" for i in range(len(_SIMPSON))]) for name in "xvw"]


def _square(speed: sm.Expr) -> sm.Expr:
    return sm.Abs(speed) * speed
