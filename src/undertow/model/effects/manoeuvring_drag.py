"""Surge force of drift and turning."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench


class ManoeuvringDrag(Wrench):
    """Surge force due to drift and turning: speed lost in a turn, or gained by the lift of a hull.

    Included because diagonal damping lets a ship keep its speed in a turn, apart from
    what the Coriolis forces take. X_vr and X_wq come on top of those. A hull or wing with lift has X_vv and
    X_ww above zero: lift stands across the flow, and leans forward on a hull that drifts.
    """

    id = "manoeuvring_drag"
    family = "damping"
    reference = (
        "Yasukawa and Yoshimura (2015), MMG standard method (hull surge force with X_vv, X_vr and X_rr); "
        "Gertler and Hagen (1967), Standard equations of motion for submarine simulation (X_ww, X_wq, X_qq)"
    )
    signature = "in turns the vehicle is slower, or faster, than the model, the same to either side"

    X_vv = Parameter("N/(m/s)^2", "surge force per sway velocity squared")
    X_vr = Parameter("N/(m/s)/(rad/s)", "surge force per sway velocity times yaw rate")
    X_rr = Parameter("N/(rad/s)^2", "surge force per yaw rate squared")
    X_ww = Parameter("N/(m/s)^2", "surge force per heave velocity squared")
    X_wq = Parameter("N/(m/s)/(rad/s)", "surge force per heave velocity times pitch rate")
    X_qq = Parameter("N/(rad/s)^2", "surge force per pitch rate squared")

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        return "surge" in dofs and bool({"sway", "heave", "pitch", "yaw"} & set(dofs))

    def wrench(self, s: Signals) -> sm.Matrix:
        _, v, w, _, q, r = s.nu_r
        level = self.X_vv * v**2 + self.X_vr * v * r + self.X_rr * r**2
        upright = self.X_ww * w**2 + self.X_wq * w * q + self.X_qq * q**2
        return sm.Matrix([level + upright, 0, 0, 0, 0, 0])
