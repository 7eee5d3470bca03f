"""One usual mistake: how to undo it in a run, what to write into the mapping file instead, and from where on
a log cannot be without one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from undertow.typing import Array

from ..logs import Mapping as LogMapping
from ..logs import Run
from .mending import Edits, edited

Channels = dict[str, Array]
Undo = Callable[[Run], Run]


@dataclass(frozen=True)
class Mistake:
    """A mistake in how a log is read.

    Attributes
    ----------
    id : str
        Name of the kind.
    told : str
        What is wrong, as a clause: "the heading is in degrees, read as radians".
    undo : callable
        Takes a run with the mistake and returns it as it would be without.
    edits : callable
        Takes the mapping that the log was read by and returns what to change in it.
    count : int
        How many single things would have had to go wrong: of two explanations the simpler one is believed.
    vehicle : str
        What to change in the vehicle file to the same end; empty where nothing there can.
    """

    id: str
    told: str
    undo: Undo
    edits: Callable[[LogMapping], Edits]
    count: int = 1
    vehicle: str = ""


def with_channels(run: Run, channels: Mapping[str, Array]) -> Run:
    """A run with some channels replaced."""
    return replace(run, channels={**run.channels, **channels})


def scaling(factors: Mapping[str, float]) -> Undo:
    """Multiply channels by factors, and what is known of their noise."""

    def undo(run: Run) -> Run:
        sigma = {n: abs(f) * run.sigma[n] for n, f in factors.items() if n in run.sigma}
        scaled = {n: f * run.channels[n] for n, f in factors.items() if run.has(n)}
        return replace(with_channels(run, scaled), sigma={**run.sigma, **sigma})

    return undo


def turning(swap: Callable[[Mapping[str, Array]], Channels]) -> Undo:
    """Apply a change of axes to all channels."""
    return lambda run: replace(run, channels=swap(run.channels))


def both(first: Mistake, second: Mistake) -> Mistake:
    """Two mistakes at once."""

    def edits(mapping: LogMapping) -> Edits:
        before = first.edits(mapping)
        return (*before, *second.edits(edited(mapping, before)))

    return Mistake(
        f"{first.id}+{second.id}",
        f"{first.told}, and {second.told}",
        lambda run: second.undo(first.undo(run)),
        edits,
        first.count + second.count,
    )


@dataclass(frozen=True)
class Settings:
    """From where on a log is not only suspicious but cannot be.

    Each stands several times farther out than anything in the sound logs of the benchmarks (ten vehicles,
    every effect of the catalogue hidden at up to twice its usual size, currents up to 1 m/s) and in four real
    data sets, and well below the factors of the units that it is to find.

    Attributes
    ----------
    contradiction : float
        Share of the motion (mean square) by which pose rates and velocities disagree, if one usual mistake
        explains it. Misaligned sensors reach 0.12, a current that is as fast as the vehicle is told apart.
    other_unit : float
        The same where a unit explains it: a factor is no matter of frames or angles. Knots make 0.19, the
        largest scale error of a sensor (see `scale`) 0.09.
    agreement : float
        Share of the motion by which the two may still disagree once a mistake is undone: beyond a half they
        have more apart than in common, and a motion that is scaled away agrees with anything.
    weakest, strongest : float
        Force that the motion needs over the one commanded. Simulated logs stay within 0.3 and 3, lags
        included; a work-class ROV answers in yaw with 0.08 of what its file has. Degrees make 57, cm/s 100,
        the usual pulse widths 0.02 and less.
    doubtful : float
        Force that the motion needs over the one commanded from which the doctor asks for the unit; weak
        thrusters and added mass that is held too small stay below.
    alike : float
        Factor within which a unit must explain that.
    near : float
        Factor within which the two must agree once a mistake is undone.
    errors : float
        Standard errors by which a gain stands out of its scatter.
    share : float
        Of the motion, beside what other forces explain, that commands must explain to be a witness. With a
        gain below `weakest`, commands of a sound log explain a hundredth of that.
    froude : float
        Speed over sqrt(g V^(1/3)), V the volume of the mass in water: torpedoes reach 11, fast ships 4.
    slowest, fastest : float
        That limit is never taken below or above these speeds, m/s: small racing boats, and the fastest hulls.
    turning : float
        Centripetal acceleration at V^(1/3) from the axis, in g: small vehicles on the spot reach 0.2.
    limit : float
        Rms of a command over its limit in the vehicle file. Controllers that wind up log a few times the
        limit; thousandths and pulse widths (1500) are far beyond.
    scale : float
        Share of its reading by which a velocity sensor may be wrong in scale; knots read as m/s are 0.49.
    ratio : float
        Share by which pose rates over velocities may differ from the factor of a unit: scales and currents do
        less, and neighbouring units of time are farther apart.
    command : float
        Factor beyond which no unit of a command is off: kN, percent, microseconds and rpm are within.
    quick, slow : float
        Usual steps, s, between which vehicles are logged: at 0.2 to 250 Hz. A log that is outside as it is
        read, and inside in another unit of time, is likelier in that than anything else is wrong with it.
    samples : int
        Samples that are looked at, the liveliest: more would only cost time.
    width : float
        Width of test functions, in the narrowest that the sampling allows: what is faster is noise.
    cluster : int
        Neighbouring test functions that count as one, since they overlap.
    distinct : float
        Commands that differ by less than this (squared, as a share) count as one: an allocation makes some
        follow from others.
    """

    contradiction: float = 0.3
    other_unit: float = 0.12
    agreement: float = 0.5
    weakest: float = 0.025
    strongest: float = 20.0
    doubtful: float = 2.5
    alike: float = 1.25
    near: float = 4.0
    errors: float = 8.0
    share: float = 0.3
    froude: float = 12.0
    slowest: float = 10.0
    fastest: float = 75.0
    turning: float = 1.0
    limit: float = 10.0
    scale: float = 0.35
    ratio: float = 0.3
    command: float = 2e4
    quick: float = 0.004
    slow: float = 5.0
    samples: int = 4000
    width: float = 2.0
    cluster: int = 8
    distinct: float = 1e-4


SETTINGS = Settings()
