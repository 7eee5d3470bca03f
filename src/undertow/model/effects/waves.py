"""A regular wave."""

from collections.abc import Mapping

import sympy as sm

from undertow.model.effect import Flow, Parameter, Signals, Wrench, column
from undertow.model.effects.rigid_body import RigidBody
from undertow.model.symbols import rotation

_NUMBER, _AHEAD, _UP = column(["wave_number", "swing_ahead", "swing_up"])
_GROUND, _WATER = (column([f"{what}_{way}" for way in "NED"]) for what in ("ground", "water"))
_PUSH = column(["push_ahead", "push_down"])


class Waves(Flow, Wrench):
    """A regular deep-water wave: water moves in circles that shrink with depth, and exerts pressure on the
    hull.

    The elevation is a cos(k s - w t + e), with s the way along the direction of travel from the NED origin
    and t the time since the start of the run; wave_cos = a cos(e) and wave_sin = a sin(e). The wave pushes
    the hull, weighing what it displaces and short against the wave, as it would push the water in its place.
    """

    id = "waves"
    reference = "Faltinsen (1990), Sea Loads on Ships and Offshore Structures, chapter 2 (linear wave theory)"
    signature = "velocity and acceleration oscillate at one frequency, whatever the commands"
    requires = ("rigid_body",)

    wave_cos = Parameter(
        "m", "elevation at the origin at the start", (-20, 20), linear=False, starts=(0.0,), per_run=True
    )
    wave_sin = Parameter(
        "m", "elevation a quarter period before", (-20, 20), linear=False, starts=(0.0,), per_run=True
    )
    wave_frequency = Parameter.with_starts(
        "rad/s", "angular frequency", (0.05, 15.0), tuple(round(0.66 + 0.075 * i, 3) for i in range(15))
    )
    wave_direction = Parameter.with_starts(
        "rad", "where it travels, from north to east", (-7, 7), (-2.36, -0.79, 0.79, 2.36), per_run=True
    )

    @classmethod
    def starts_near(cls, seen: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
        if "dominant_frequency" not in seen:
            return []
        low, high = seen["dominant_frequency"]
        still = {"wave_cos": 0.0, "wave_sin": 0.0}
        return [
            still | {"wave_frequency": low + share * (high - low), "wave_direction": towards}
            for share in (0.25, 0.5, 0.75)
            for towards in cls.wave_direction.starts
        ]

    def velocity(self, s: Signals) -> sm.Matrix:
        return self.wave_frequency * self._upright(_AHEAD, -_UP)

    def acceleration(self, s: Signals) -> sm.Matrix:
        return self._upright(*self._rate(_GROUND))

    def wrench(self, s: Signals) -> sm.Matrix:
        force = RigidBody(self.thrusters).m * rotation(sm.Matrix(s.eta[3:])).T * self._upright(*_PUSH)
        return sm.Matrix([*force, 0, 0, 0])

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        phase = _NUMBER * self._heading.dot(sm.Matrix(s.eta[:3])) - self.wave_frequency * s.t
        c, d, fading = sm.cos(phase), sm.sin(phase), sm.exp(-_NUMBER * s.eta[2])
        swing = self.wave_cos * c - self.wave_sin * d, self.wave_cos * d + self.wave_sin * c
        over_ground = rotation(sm.Matrix(s.eta[3:])) * sm.Matrix(s.nu[:3])
        # The pressure is that of the water's own acceleration, which follows the water and not the hull.
        names = [_NUMBER, _AHEAD, _UP, *_GROUND, *_WATER, *_PUSH]
        meanings = [self.wave_frequency**2 / s.g, *(fading * e for e in swing), *over_ground]
        return dict(zip(names, [*meanings, *self.velocity(s), *self._rate(_WATER)], strict=True))

    @property
    def _heading(self) -> sm.Matrix:
        return sm.Matrix([sm.cos(self.wave_direction), sm.sin(self.wave_direction), 0])

    def _upright(self, ahead: sm.Expr, down: sm.Expr) -> sm.Matrix:
        """A vector in the plane in which the water moves, NED."""
        return ahead * self._heading + sm.Matrix([0, 0, down])

    def _rate(self, moving: sm.Matrix) -> tuple[sm.Expr, sm.Expr]:
        """Rate of the water's velocity, ahead and down, at a point that moves with `moving`, m/s^2."""
        turning = _NUMBER * self._heading.dot(moving) - self.wave_frequency
        fading = -_NUMBER * moving[2]
        ahead, up = fading * _AHEAD - turning * _UP, fading * _UP + turning * _AHEAD
        return self.wave_frequency * ahead, -self.wave_frequency * up
