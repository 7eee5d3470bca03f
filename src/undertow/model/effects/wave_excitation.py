"""What a regular wave does to a hull at the surface."""

from dataclasses import dataclass
from math import cos, inf, sin
from typing import Any

import sympy as sm

from undertow.model.effect import DOFS, FORCE, Parameter, Signals, Wrench, column, symbol

HARMONICS = 6  # of the heading, from 0 on: waves as long as half the hull need no more
# Motions of which a wave from starboard is the mirror image of that from port.
ODD = ("sway", "roll", "yaw")
_UP, _AHEAD = column(["swell_up", "swell_ahead"])
_HEADING = symbol("swell_heading")


def _series(i: int) -> str:
    return "sine" if DOFS[i] in ODD else "cosine"


@dataclass(frozen=True)
class Headings(Parameter):
    """A force for every direction of the wave, as a series of cosines (or sines) of it; reads as its sum."""

    pattern: str = ""
    dofs: tuple[str, ...] = DOFS

    def __get__(self, effect: Any, owner: type | None = None) -> Any:
        if effect is None:
            return self
        return sm.Matrix([self._sum(i) for i in range(6)])

    def _sum(self, i: int) -> sm.Expr:
        turn = sm.sin if DOFS[i] in ODD else sm.cos
        return sum((symbol(self._name(i, n)) * turn(n * _HEADING) for n in self._orders(i)), sm.Integer(0))

    def _orders(self, i: int) -> range:
        return range(int(DOFS[i] in ODD), HARMONICS) if DOFS[i] in self.dofs else range(0)

    def _name(self, i: int, n: int) -> str:
        return self.pattern.format(F=FORCE[i], n=n)

    def expand(self, thrusters: tuple[str, ...], surfaces: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        """One parameter for each motion and harmonic."""
        return tuple(
            Parameter(
                f"N{' m' * (i > 2)}/{self.unit}",
                f"{DOFS[i]} {'moment' if i > 2 else 'force'} {self.about}, {_series(i)} {n}",
                name=self._name(i, n),
            )
            for i in range(6)
            for n in self._orders(i)
        )


class WaveExcitation(Wrench):
    """Force of a regular wave on a hull at the surface, and its mean drift force, for all headings.

    Beside `waves`, which moves the water around a hull that is small against the wave and under it: here the
    hull pierces the surface, is as long as the wave and scatters it. The elevation is as in `waves`,
    a cos(k s - w t + e) with swell_cos = a cos(e) and swell_sin = a sin(e). Forces are those on the hull held
    fast, of this one frequency, as harmonics of the angle between the bow and where the wave travels, to
    starboard; port and starboard are alike. The drift force is that of a freely moving hull.
    """

    id = "wave_excitation"
    family = "water"
    of_shape = True
    reference = "Faltinsen (1990), Sea Loads on Ships and Offshore Structures, chapters 3 and 5"
    signature = "forces oscillate at the frequency of the waves, with a mean force in their direction"

    swell_cos = Parameter(
        "m", "elevation at the origin at the start", (-20, 20), linear=False, default=0.0, per_run=True
    )
    swell_sin = Parameter(
        "m", "elevation a quarter period before", (-20, 20), linear=False, default=0.0, per_run=True
    )
    swell_frequency = Parameter.with_default("rad/s", "angular frequency", (0.05, 60.0), 1.0)
    swell_direction = Parameter.with_default("rad", "where it travels, from north to east", (-7, 7), 0.0)
    in_phase = Headings("m", "per elevation", (-inf, inf), pattern="{F}_swell{n}")
    ahead = Headings("m", "per elevation a quarter period before", (-inf, inf), pattern="{F}_swellq{n}")
    drift = Headings(
        "m^2", "per amplitude squared", (-inf, inf), pattern="{F}_drift{n}", dofs=("surge", "sway", "yaw")
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        squared = self.swell_cos**2 + self.swell_sin**2
        return self.in_phase * _UP + self.ahead * _AHEAD + self.drift * squared

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        way = s.eta[0] * sm.cos(self.swell_direction) + s.eta[1] * sm.sin(self.swell_direction)
        phase = self.swell_frequency**2 / s.g * way - self.swell_frequency * s.t
        c, d = sm.cos(phase), sm.sin(phase)
        up, ahead = self.swell_cos * c - self.swell_sin * d, self.swell_cos * d + self.swell_sin * c
        return {_UP: up, _AHEAD: ahead, _HEADING: self.swell_direction - s.eta[5]}


def harmonics(dof: str, heading: float) -> list[float]:
    """What the coefficients of a motion are multiplied by, one for each harmonic it has; heading in rad."""
    return [(sin if dof in ODD else cos)(n * heading) for n in range(int(dof in ODD), HARMONICS)]
