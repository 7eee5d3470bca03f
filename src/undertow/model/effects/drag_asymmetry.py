"""Drag that differs between forward and backward motion."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench


class DragAsymmetry(Wrench):
    """Additional drag when the vehicle moves backward along an axis (negative: less drag than forward)."""

    id = "drag_asymmetry"
    family = "damping"
    reference = "mini-AUV paper (2021), section 5.1 (separate coefficients for forward and backward motion)"
    signature = "the speed reached astern differs from the speed ahead at the same thrust"
    scales_with = "drag"

    X_u_back = Parameter("N/(m/s)", "additional surge force per velocity, backward only")
    X_uabsu_back = Parameter(
        "N/(m/s)^2", "additional surge force per velocity times its magnitude, backward only"
    )
    Y_v_back = Parameter("N/(m/s)", "additional sway force per velocity, to port only")
    Y_vabsv_back = Parameter(
        "N/(m/s)^2", "additional sway force per velocity times its magnitude, to port only"
    )
    Z_w_back = Parameter("N/(m/s)", "additional heave force per velocity, upward only")
    Z_wabsw_back = Parameter(
        "N/(m/s)^2", "additional heave force per velocity times its magnitude, upward only"
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        back = [(v - sm.Abs(v)) / 2 for v in s.nu_r[:3]]
        linear = [self.X_u_back, self.Y_v_back, self.Z_w_back]
        square = [self.X_uabsu_back, self.Y_vabsv_back, self.Z_wabsw_back]
        # back is zero ahead and the (negative) velocity astern, so |v| v astern is -back^2.
        force = [a * v - b * v**2 for a, b, v in zip(linear, square, back, strict=True)]
        return sm.Matrix([*force, 0, 0, 0])
