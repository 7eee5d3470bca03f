"""Liquid or a hanging load that swings to and fro."""

from math import inf

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench, column

_SWING = column(["swing_x", "swing_y"])


class Slosh(Wrench):
    """A mass that swings in the hull with little damping: liquid in a tank, a load on a hook, bilge water.

    Included because tanks and cranes are common and their oscillation is neither damping nor added mass: the
    hull is still pushed long after it moved. One mass on a spring in surge and sway, with its displacement in
    the hull and its own velocity as states. It is additional to the mass of the rigid body: subtract it there
    if it was included in the weighing.
    """

    id = "slosh"
    family = "memory"
    reference = (
        "Ibrahim (2005), Liquid Sloshing Dynamics: Theory and Applications (equivalent mechanical models)"
    )
    signature = "after a change of thrust the speed oscillates at one frequency that no other term has"

    m_slosh = Parameter("kg", "mass that swings", (0, inf))
    slosh_frequency = Parameter(
        "rad/s",
        "its angular frequency in a fixed hull",
        (0.1, 30),
        linear=False,
        starts=(0.4, 0.5, 0.63, 0.8, 1, 1.25, 1.6, 2, 2.5, 3.2, 4, 5, 6.3),  # a resonance is narrow
        neutral=None,
    )
    slosh_damping = Parameter.with_starts("1", "its damping ratio", (0.01, 0.7), (0.1,))
    states = ("slosh_x", "slosh_y", "slosh_u", "slosh_v")
    state_units = ("m", "m", "m/s", "m/s")

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        return bool({"surge", "sway"} & set(dofs))

    def wrench(self, s: Signals) -> sm.Matrix:
        place, push = self.state_symbols[:2, :], -self.m_slosh * self._pull()
        return sm.Matrix([*push, 0, 0, 0, place[0] * push[1] - place[1] * push[0]])

    def rates(self, s: Signals) -> sm.Matrix:
        u, v = self.state_symbols[2:, :]
        pull, turning = self._pull(), s.nu[5] * sm.Matrix([v, -u])
        return sm.Matrix([*_SWING, *(pull + turning)])

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        x, y, u, v = self.state_symbols
        return dict(zip(_SWING, [u - s.nu[0] + s.nu[5] * y, v - s.nu[1] - s.nu[5] * x], strict=True))

    def _pull(self) -> sm.Matrix:
        """Force of the hull on the mass over the mass, shape (2, 1), m/s^2."""
        w = self.slosh_frequency
        return -(w**2) * self.state_symbols[:2, :] - 2 * self.slosh_damping * w * _SWING
