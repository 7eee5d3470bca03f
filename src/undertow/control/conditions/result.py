"""What the checker of gains says, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field

from undertow.notebook import html

from .problem import Range, Span

HOLDS, FAILS, UNPROVED, NO_IOTA = "holds", "fails", "not proved", "no iota"


@dataclass(frozen=True)
class CertificateSettings:
    """The numbers that decide what counts as certified.

    Attributes
    ----------
    thrust_reserve : float
        Part of each thruster's limit that holding the set-point has to leave for control. A tenth is what
        voltage and propeller tolerances of small thrusters take between dives.
    smallest_error : float
        A region that ends at a smaller error of some coordinate is none, m and rad: sensors aboard do not
        resolve it.
    largest_error : float
        Errors beyond it are not looked at where thrusters have limits, m.
    largest_offset : float
        Error of the reported pose, m and rad, with which a loop may come to rest and still holds its
        set-point: the accuracy of acoustic positioning and magnetic compasses.
    slowest : float
        A motion that decays more slowly is one that does not decay, 1/s: its time constant is over a week.
    headings : int
        At how many headings the whole loop is linearised where its motion depends on the heading.
    starts : int
        How many starts are simulated where effects or axes are outside the certificate.
    lasts : float
        Length of these simulations in slowest time constants.
    durations : (float, float)
        Its limits, s: what takes longer than a quarter of an hour is judged by that.
    dt : float
        Sampling interval there, s; a tenth of it where the law needs that.
    comes_back : float
        Part of the error of the start that may be left at the end.
    slack : float
        Factor on what the slowest pole leaves of it, where that is more: poles are those near rest only.
    """

    thrust_reserve: float = 0.1
    smallest_error: float = 1e-2
    largest_error: float = 1e4
    largest_offset: float = 0.1
    slowest: float = 1e-6
    headings: int = 12
    starts: int = 8
    lasts: float = 20.0
    durations: tuple[float, float] = (30.0, 900.0)
    dt: float = 0.01
    comes_back: float = 0.25
    slack: float = 1.2


SETTINGS = CertificateSettings()


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
class Command:
    """What one limited thruster is asked for.

    Attributes
    ----------
    name : str
        The thruster.
    steady : float
        Magnitude of the command that holds the vehicle at the set-point, in units of the command.
    largest : float
        Bound on its magnitude in the certified region.
    limit : float
        What it can give.
    """

    name: str
    steady: float
    largest: float
    limit: float


@dataclass(frozen=True)
class Region:
    """From where a loop is certified to come to its set-point.

    Attributes
    ----------
    kind : str
        "everywhere"; "level", a bounded region that no motion leaves; or "none".
    text : str
        The statement in words.
    level : float or None
        V is below it in the region, J; None where the region is a box of errors and surfaces.
    errors, speeds : dict of float
        Largest error of each coordinate (m, rad) and largest body velocities (m/s, rad/s) in the region.
    starts : dict of float
        Largest error of each coordinate to begin with: at rest, the others and integrals zero.
    commands : tuple of Command
        What each limited thruster is asked for.
    iota : float or None
        The iota that it is stated for; PID only.
    proved : bool
        False for an estimate at sampled attitudes.
    """

    kind: str
    text: str
    level: float | None = None
    errors: dict[str, float] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    starts: dict[str, float] = field(default_factory=dict)
    commands: tuple[Command, ...] = ()
    iota: float | None = None
    proved: bool = True


@dataclass(frozen=True)
class LeftAlone:
    """What becomes of the axes that no thruster pushes, while the others are at their set-points.

    Attributes
    ----------
    axes : tuple of str
        Degrees of freedom.
    poles : list of complex
        Of their own motion at rest (zero dynamics), 1/s; a zero one is a place that nothing holds.
    stable : bool
        Whether they come to rest.
    text : str
        Where they go, in words.
    """

    axes: tuple[str, ...]
    poles: list[complex]
    stable: bool
    text: str


@dataclass(frozen=True)
class WholeLoop:
    """The loop with all effects, sensors and limits, linearised at its rest and tried by simulation.

    Attributes
    ----------
    verdict : str
        "stable", "unstable", "off the set-point" or "not judged".
    pole : complex or None
        The pole that grows fastest or decays slowest, 1/s.
    text : str
        Where that is, or why it was not judged.
    offset : dict of float
        How far from the set-point the reported pose comes to rest, m and rad.
    simulated : str
        What simulations from starts in the region came to.
    """

    verdict: str
    pole: complex | None
    text: str
    offset: dict[str, float] = field(default_factory=dict)
    simulated: str = ""

    @property
    def stable(self) -> bool:
        """Whether it was judged and found stable."""
        return self.verdict == "stable"


@dataclass(frozen=True, repr=False)
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
    region : Region
        From where the loop is certified to come to its set-point.
    alone : LeftAlone or None
        What becomes of the axes that no thruster pushes.
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
    region: Region
    alone: LeftAlone | None = None
    left_out: dict[str, str] = field(default_factory=dict)
    uncertainty: str = ""
    whole: WholeLoop | None = None

    @property
    def conditions_hold(self) -> bool:
        """Whether every condition of every form holds, one iota serves all, and every channel is stable."""
        rows = all(r.verdict == HOLDS for r in self.rows)
        together = all(a.verdict == HOLDS for a in self.agreements)
        border = SETTINGS.slowest if self.alone else 0.0  # what nothing pushes stays where it is
        coupled = all(r.real < border for roots in self.coupled.values() for r in roots)
        return rows and together and coupled and all(c.stable for c in self.channels)

    @property
    def ok(self) -> bool:
        """Whether the loop is certified.

        Conditions hold; motions from a region come to rest within the limits of the thrusters or, where axes
        are left alone, those come to rest; and the loop with all effects is stable where there are others.
        """
        certified = self.alone.stable if self.alone else self.region.kind != "none"
        return self.conditions_hold and certified and (self.whole is None or self.whole.stable)

    def __repr__(self) -> str:
        held = sum(row.verdict == HOLDS for row in self.rows)
        said = "certified" if self.ok else "not certified"
        return f"{self.gains} on {self.vehicle}: {said}; {held} of {len(self.rows)} conditions hold"

    def _repr_html_(self) -> str:
        head = ("form", "statement", "scope", "signs", "left", "right", "margin", "verdict")
        return html(repr(self), head, ([getattr(row, name) for name in head] for row in self.rows))
