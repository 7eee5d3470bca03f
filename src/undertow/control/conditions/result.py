"""What the checker of gains says, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field

from .feasible import Span
from .uncertain import Range

HOLDS, FAILS, UNPROVED, NO_IOTA = "holds", "fails", "not proved", "no iota"
_ZERO = 1e-6


@dataclass(frozen=True)
class Row:
    """One condition, in one set of parameters, for one channel or as matrices.

    Attributes
    ----------
    form, condition, statement, about, source : str
        The condition; see `Condition`.
    scope : str
        "matrices", or the pose coordinate of a channel.
    signs : str
        Which set of parameters: "forward", "backward", signs of velocities, or nothing where there is one.
    left, right, margin : float
        The two sides (at `iota`), and the least margin over all attitudes.
    verdict : str
        `HOLDS`, `FAILS`, `UNPROVED` (found nowhere to fail, but the bound over attitudes is not settled) or
        `NO_IOTA` (there is no iota that satisfies it; sides and margin are those at the best one).
    iota : (float, float) or None
        The values of iota that satisfy it; None where none does or the condition has no iota.
    uses_iota : bool
        Whether the condition contains iota.
    at_iota : float or None
        The iota that the sides are evaluated at.
    where : str
        Where the margin is least and why it is nowhere less.
    box, ellipsoid : Range or None
        Verdicts over the uncertainty of the parameters.
    """

    form: str
    condition: str
    statement: str
    about: str
    source: str
    scope: str
    signs: str
    left: float
    right: float
    margin: float
    verdict: str
    iota: Span | None = None
    uses_iota: bool = False
    at_iota: float | None = None
    where: str = ""
    box: Range | None = None
    ellipsoid: Range | None = None


@dataclass(frozen=True)
class Agreement:
    """Whether one iota satisfies all conditions of a form in all sets of parameters.

    Attributes
    ----------
    form : str
        The form.
    iota : (float, float) or None
        The values of iota that do.
    verdict : str
        `HOLDS`, `NO_IOTA`, or `FAILS` (the iota that was given is none of them).
    """

    form: str
    iota: Span | None
    verdict: str


@dataclass(frozen=True)
class Channel:
    """One linearised channel at rest.

    Attributes
    ----------
    coordinate, signs : str
        Pose coordinate, with "heading east" where x acts on sway and y on surge, and set of parameters.
    polynomial : list of float
        Characteristic polynomial, highest power first, SI.
    first_column : list of float
        First column of its Routh array.
    roots : list of complex
        Its roots, 1/s.
    stable : bool
        Whether no sign changes in the first column and no root is on the imaginary axis.
    """

    coordinate: str
    signs: str
    polynomial: list[float]
    first_column: list[float]
    roots: list[complex]
    stable: bool


@dataclass(frozen=True)
class Lyapunov:
    """A Lyapunov candidate and what the model says of it.

    Attributes
    ----------
    V, V_dot : str
        The candidate, and its derivative along the closed loop.
    equation : str
        What it is in the paper.
    identity : str
        How V_dot was compared with the derivative worked out from the model, and with what result.
    zero_set : str
        Where V_dot is zero.
    invariant : str
        Its largest invariant subset (LaSalle).
    """

    V: str
    V_dot: str
    equation: str
    identity: str
    zero_set: str
    invariant: str


@dataclass(frozen=True)
class Region:
    """Where the local result of PID control holds.

    Attributes
    ----------
    iota : float or None
        The iota that it is stated for.
    angle : float or None
        Largest error of the angles that the inertia depends on, rad; infinite where it depends on none.
    level : float or None
        The set {V < level} stays within that error.
    text : str
        The statement in words.
    """

    iota: float | None
    angle: float | None
    level: float | None
    text: str


@dataclass(frozen=True)
class WholeLoop:
    """The loop with all effects, linearised at rest.

    Attributes
    ----------
    stable : bool or None
        Whether no pole grows; None where it could not be judged.
    pole : complex or None
        The pole that grows fastest or decays slowest, 1/s.
    text : str
        Where that is, or why it was not judged.
    """

    stable: bool | None
    pole: complex | None
    text: str


@dataclass(frozen=True)
class Report:
    """Everything that is known of a gain set on a vehicle.

    Attributes
    ----------
    vehicle, gains, law : str
        Names.
    rows : tuple of Row
        The conditions.
    agreements : tuple of Agreement
        One iota for all, by form.
    channels : tuple of Channel
        Linearised channels.
    coupled : dict
        Roots of all axes together by set of parameters, where axes are coupled or the heading counts.
    lyapunov : Lyapunov
        Candidate and derivative.
    region : Region or None
        PID only.
    actuation : str
        Empty, or what follows from forces that no thruster gives.
    speed : str
        Damping at speed against that at rest; PD only, whose claim is for all motions.
    left_out : dict of str
        Effects that no condition knows, with the reason.
    uncertainty : str
        Where the uncertainty of the parameters is from, and its confidence.
    whole : WholeLoop or None
        The loop with the effects that no condition knows; None where it was not looked at.
    """

    vehicle: str
    gains: str
    law: str
    rows: tuple[Row, ...]
    agreements: tuple[Agreement, ...]
    channels: tuple[Channel, ...]
    coupled: dict[str, list[complex]]
    lyapunov: Lyapunov
    region: Region | None
    actuation: str
    speed: str = ""
    left_out: dict[str, str] = field(default_factory=dict)
    uncertainty: str = ""
    whole: WholeLoop | None = None

    @property
    def conditions_hold(self) -> bool:
        """Whether every condition of every form holds, one iota serves all, and every channel is stable."""
        rows = all(r.verdict == HOLDS for r in self.rows)
        together = all(a.verdict == HOLDS for a in self.agreements)
        border = _ZERO if self.actuation else 0.0  # what nothing pushes stays where it is
        coupled = all(r.real < border for roots in self.coupled.values() for r in roots)
        return rows and together and coupled and all(c.stable for c in self.channels)

    @property
    def ok(self) -> bool:
        """Whether conditions hold, every force asked for can be given, and the whole loop is not unstable."""
        grows = self.whole is not None and self.whole.stable is False
        return self.conditions_hold and not self.actuation and not grows
