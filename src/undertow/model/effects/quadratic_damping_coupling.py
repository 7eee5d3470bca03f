"""Quadratic damping between different motions."""

import sympy as sm

from undertow.model.effect import DerivativeMatrix, Parameter, Signals, Wrench

_PAIRS = ((1, 5), (5, 1), (2, 4), (4, 2))


class QuadraticDampingCoupling(Wrench):
    """Drag of a hull whose bow and stern differ: sway with yaw and heave with pitch, by |v| v, |v| r, |r| v.

    Included because tow and turning tests of model ships and torpedoes are published
    with these second-order modulus terms. `crossflow_drag` is the same physics for a hull of one section all
    along, with three numbers; here every pair of motions has a number of its own.
    """

    id = "quadratic_damping_coupling"
    family = "damping"
    reference = (
        "Fossen (2021), chapter 6 (second-order modulus functions: Y_|r|v, N_|v|r and the like); "
        "Skjetne, Smogeli and Fossen (2004), MIC 25(1); Prestero (2001) for heave and pitch"
    )
    series_of = ("crossflow_drag",)
    signature = (
        "drifting sideways turns the vehicle, and drift and turning together cost more than each alone"
    )
    scales_with = "drag"

    coefficients = DerivativeMatrix(
        "{F}_{m}abs{m}",
        ("(m/s)^2", "(rad/s)^2"),
        _PAIRS,
        "{force} per {motion} velocity times its magnitude",
    )
    Y_vabsr = Parameter("N/(m/s)/(rad/s)", "sway force per sway velocity times |yaw rate|", on_left_side=True)
    Y_rabsv = Parameter("N/(m/s)/(rad/s)", "sway force per yaw rate times |sway velocity|", on_left_side=True)
    N_vabsr = Parameter(
        "N m/(m/s)/(rad/s)", "yaw moment per sway velocity times |yaw rate|", on_left_side=True
    )
    N_rabsv = Parameter(
        "N m/(m/s)/(rad/s)", "yaw moment per yaw rate times |sway velocity|", on_left_side=True
    )

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        return {"sway", "yaw"} <= set(dofs) or {"heave", "pitch"} <= set(dofs)

    def wrench(self, s: Signals) -> sm.Matrix:
        v, r = s.nu_r[1], s.nu_r[5]
        sway = self.Y_vabsr * sm.Abs(r) * v + self.Y_rabsv * sm.Abs(v) * r
        yaw = self.N_vabsr * sm.Abs(r) * v + self.N_rabsv * sm.Abs(v) * r
        squares = self.coefficients * s.nu_r.applyfunc(lambda x: sm.Abs(x) * x)
        return squares + sm.Matrix([0, sway, 0, 0, 0, yaw])
