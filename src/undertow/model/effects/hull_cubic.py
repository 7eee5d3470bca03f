"""Hull forces of third and fourth order in drift and turning."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench, symbol

_U = symbol("U")


class HullCubic(Wrench):
    """Sway force and yaw moment of third order in drift and turning, surge force of fourth (ships at speed).

    Included because captive tests of ships are published as polynomials in v' = v/U and
    r' = r L/U times the dynamic pressure of U: Y_vvv_per_U multiplies v^3/U, X_vvvv_per_UU v^4/U^2, with
    U^2 = u^2 + v^2. Below the speed U_fade the terms fade, as a polynomial in r/U has no value at rest.
    The linear ones are `lift`, which has u where the polynomial has U; since U v = u v + v^3/(2 U) + ...,
    half of Y_v goes into Y_vvv_per_U, and half of Y_r into Y_vvr_per_U.
    """

    id = "hull_cubic"
    family = "damping"
    reference = (
        "Yasukawa and Yoshimura (2015), MMG standard method (hull forces, polynomials in v' and r'); "
        "Abkowitz (1964) for the series itself"
    )
    series_of = ("crossflow_drag",)
    signature = "in tight turns, not in gentle ones, sway force and yaw moment differ from what lift gives"

    X_vvvv_per_UU = Parameter("N/(m/s)^2", "surge force per v^4/U^2")
    Y_vvv_per_U = Parameter("N/(m/s)^2", "sway force per v^3/U")
    Y_vvr_per_U = Parameter("N/(m/s)/(rad/s)", "sway force per v^2 r/U")
    Y_vrr_per_U = Parameter("N/(rad/s)^2", "sway force per v r^2/U")
    Y_rrr_per_U = Parameter("N (m/s)/(rad/s)^3", "sway force per r^3/U")
    N_vvv_per_U = Parameter("N m/(m/s)^2", "yaw moment per v^3/U")
    N_vvr_per_U = Parameter("N m/(m/s)/(rad/s)", "yaw moment per v^2 r/U")
    N_vrr_per_U = Parameter("N m/(rad/s)^2", "yaw moment per v r^2/U")
    N_rrr_per_U = Parameter("N m (m/s)/(rad/s)^3", "yaw moment per r^3/U")
    U_fade = Parameter.with_default("m/s", "speed below which the terms fade", (1e-3, 10.0), 0.05)

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        # A series of ships: what does not float at the surface has cross-flow in two planes.
        return {"surge", "sway", "yaw"} <= set(dofs) and "heave" not in dofs

    def wrench(self, s: Signals) -> sm.Matrix:
        v, r = s.nu_r[1], s.nu_r[5]
        terms = sm.Matrix([v**3, v**2 * r, v * r**2, r**3]) / _U
        sway = sm.Matrix([self.Y_vvv_per_U, self.Y_vvr_per_U, self.Y_vrr_per_U, self.Y_rrr_per_U])
        yaw = sm.Matrix([self.N_vvv_per_U, self.N_vvr_per_U, self.N_vrr_per_U, self.N_rrr_per_U])
        return sm.Matrix([self.X_vvvv_per_UU * v**4 / _U**2, sway.dot(terms), 0, 0, 0, yaw.dot(terms)])

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        return {_U: sm.sqrt(s.nu_r[0] ** 2 + s.nu_r[1] ** 2 + self.U_fade**2)}
