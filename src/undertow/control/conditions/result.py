"""What the checker of gains says, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from undertow.notebook import html
from undertow.typing import Array

from .by_law import Lyapunov
from .problem import RobustVerdict, Span

HOLDS, FAILS = "holds", "fails"
UNPROVED = "not proved"
"""Fails at no point found, but the bound over attitudes does not prove that it holds."""
NO_IOTA = "no iota"
"""No iota satisfies it; sides and margin are those at the best one."""


@dataclass(frozen=True)
class CertificateSettings:
    """The numbers that decide what counts as certified."""

    # Part of each thruster's limit that holding the set-point has to leave for control: what voltage and
    # propeller tolerances of small thrusters take between dives.
    thrust_reserve: float = 0.1
    # A region that ends at a smaller error of some coordinate is none, m and rad: sensors aboard do not
    # resolve it.
    smallest_error: float = 1e-2
    # Errors of every coordinate, m and rad, that the region of a quadratic V is searched for where none are
    # stated: from half a metre and 29 degrees down to what sensors resolve.
    default_starts: tuple[float, ...] = (0.5, 0.1, 0.02)
    lowest_level: float = 1e-30  # level of V, J, below which a region counts as none
    highest_level: float = 1e30  # the same above which it counts as everything
    level_tolerance: float = 0.01  # of its logarithm
    largest_error: float = 1e4  # errors beyond it are not looked at where thrusters have limits, m
    # Error of the reported pose, m and rad, with which a loop may come to rest and still hold its set-point:
    # the accuracy of acoustic positioning and magnetic compasses.
    largest_offset: float = 0.1
    # A motion that decays more slowly does not count as decaying, 1/s: its time constant is over a week.
    slowest_decay: float = 1e-6
    no_force: float = 1e-9  # force or moment at the set-point that is rounding, N and N m
    rank: float = 1e-9  # singular values of the whole loop, balanced, below this part of the largest
    # At how many headings the whole loop is linearised where its motion depends on the heading.
    headings: int = 12
    pade_order: int = 4  # order of the approximation of dead times there
    # How much faster a law that jumps leaves the layer that stands for the jump than its surface leads to the
    # set-point.
    layer_speed: float = 20.0
    simulated_starts: int = 8  # that are simulated where effects or axes are outside the certificate
    time_constants: float = 20.0  # length of these simulations in slowest time constants
    # Its limits, s: what takes longer than a quarter of an hour is judged by that.
    durations: tuple[float, float] = (30.0, 900.0)
    dt: float = 0.01  # sampling interval there, s
    finer: float = 10.0  # and so much shorter where the law needs that
    largest_residual: float = 0.25  # part of the error of the start that may be left at the end
    # Factor on what the slowest pole leaves of it, where that is more: poles are those near rest only.
    pole_slack: float = 1.2


SETTINGS = CertificateSettings()


@dataclass(frozen=True)
class Row:
    """One condition, in one set of parameters, for one channel or as matrices; see `Condition`."""

    form: str
    condition: str
    statement: str
    about: str
    source: str
    scope: str  # "matrices", or the pose coordinate of a channel
    signs: str  # set of parameters: "forward", "backward", signs of velocities, or nothing if there is one
    left: float  # the two sides, at `at_iota`
    right: float
    margin: float  # the least over all attitudes
    verdict: str  # HOLDS, FAILS, UNPROVED or NO_IOTA
    iota: Span | None = None  # the values that satisfy it; None where none does or it has no iota
    uses_iota: bool = False
    at_iota: float | None = None
    where: str = ""  # where the margin is least and why it is nowhere less
    box: RobustVerdict | None = None  # verdicts over the uncertainty of the parameters
    ellipsoid: RobustVerdict | None = None


@dataclass(frozen=True)
class Agreement:
    """Whether one iota satisfies all conditions of a form in all sets of parameters."""

    form: str
    iota: Span | None  # the values that do
    verdict: str  # HOLDS, NO_IOTA, or FAILS (the iota that was given is none of them)


@dataclass(frozen=True)
class Channel:
    """One linearised channel at rest."""

    coordinate: str  # with "heading east" where x acts on sway and y on surge
    signs: str  # set of parameters
    polynomial: list[float]  # characteristic polynomial, highest power first, SI
    first_column: list[float]  # of its Routh array
    roots: list[complex]  # 1/s
    stable: bool  # no sign changes in the first column and no root is on the imaginary axis


@dataclass(frozen=True)
class Command:
    """What one limited thruster is asked for, in units of its command."""

    name: str
    steady: float  # magnitude that holds the vehicle at the set-point
    largest: float  # bound on the magnitude in the certified region
    limit: float


@dataclass(frozen=True)
class Quadratic:
    """V = z' P z with z = (integral, error, velocity), proved to fall where it is below one.

    The error (set-point less pose) and its integral stand in a frame turned by G, E = G' error, and so does
    the velocity of the translations, w = diag(G' R, I) nu with R from body to earth. PD control has no
    integral.
    """

    # By range of headings of the set-point, which share a turn equally from north on; one where the heading
    # does not matter. Shape (ranges, 3n, 3n) or (ranges, 2n, 2n), SI.
    P: Array
    frame: str  # what G turns by: "body" (G = R) or "earth" (not at all)
    errors: Array  # largest of each coordinate, m and rad
    speeds: Array  # largest body velocities
    starts: Array  # largest error of each coordinate alone, at rest
    commands: Array  # bound on the magnitude of each limited command
    start: float  # bound on V over the start box

    def at(self, heading: float) -> Array:
        """P for a heading of the set-point, rad, shape (3n, 3n) or (2n, 2n)."""
        share = heading / (2 * np.pi) % 1.0
        return np.asarray(self.P[min(int(share * len(self.P)), len(self.P) - 1)])


@dataclass(frozen=True)
class Transient:
    """Proved bounds in time on every motion that begins at rest in a box of errors, by piece of time.

    The last piece has no end: in it motions come to rest, at least like exp(-rate t).
    """

    times: Array  # at which each piece begins, s
    errors: Array  # of each coordinate, m and rad, shape (pieces, n)
    speeds: Array  # of each body velocity, shape (pieces, n)
    commands: Array  # magnitude of each limited command, shape (pieces, m)
    rate: float  # 1/s

    @property
    def halving_time(self) -> float:
        """From when on all errors stay within half of their largest bounds, s; bounds may rise in between."""
        beyond = np.flatnonzero((self.errors > 0.5 * self.errors.max(axis=0)).any(axis=1))
        return float(np.append(self.times, np.inf)[beyond[-1] + 1])

    def between(self, begin: float, end: float) -> Transient:
        """The largest of the bounds between two times, as one piece."""
        low = int(np.searchsorted(self.times, begin, "right")) - 1
        own = slice(low, max(int(np.searchsorted(self.times, end, "left")), low + 1))
        errors, speeds, commands = (m[own].max(axis=0) for m in (self.errors, self.speeds, self.commands))
        return Transient(np.array(begin), errors, speeds, commands, self.rate)


def merge_headings(proofs: Sequence[Quadratic], half_turn: Array) -> Quadratic:
    """One statement of what was proved for ranges of headings, those of the other half of a turn with it."""
    P = np.concatenate([p.P for p in proofs])
    if len(proofs) > 1:
        P = np.concatenate([P, P * np.outer(half_turn, half_turn)])
    return Quadratic(
        P=P,
        frame=proofs[0].frame,
        errors=np.max([p.errors for p in proofs], axis=0),
        speeds=np.max([p.speeds for p in proofs], axis=0),
        starts=np.min([p.starts for p in proofs], axis=0),
        commands=np.max([p.commands for p in proofs], axis=0),
        start=max(p.start for p in proofs),
    )


@dataclass(frozen=True)
class Region:
    """From where a loop is certified to come to its set-point."""

    # "everywhere"; "level", a bounded region that no motion leaves; "box", starts at rest; or "none".
    kind: str
    text: str
    level: float | None = None  # v is below it in the region, J; None for a box of errors and surfaces
    errors: dict[str, float] = field(default_factory=dict)  # largest of each coordinate, m and rad
    speeds: dict[str, float] = field(default_factory=dict)  # largest body velocities, m/s and rad/s
    # Largest error of each coordinate to begin with: at rest, the others and integrals zero.
    starts: dict[str, float] = field(default_factory=dict)
    commands: tuple[Command, ...] = ()
    start: dict[str, float] = field(default_factory=dict)  # box of errors that was asked for, m and rad
    contains_start: bool | None = None  # whether the region holds it; None where none was asked for
    quadratic: Quadratic | None = None  # V, where it was found by a semidefinite program
    transient: Transient | None = None  # bounds in time, where the region is a box of starts
    # Intervals of the parameters that it is for, SI, signs of the vehicle file; others are as in the file.
    parameters: dict[str, Span] = field(default_factory=dict)

    @property
    def by_search(self) -> bool:
        """Whether it was searched for and proved: conditions derived from the model are not needed then."""
        return self.quadratic is not None or self.transient is not None


@dataclass(frozen=True)
class ZeroDynamics:
    """What becomes of the axes that no thruster pushes, while the others are at their set-points."""

    axes: tuple[str, ...]  # degrees of freedom
    poles: list[complex]  # of their zero dynamics at rest, 1/s; a zero one is a place that nothing holds
    stable: bool  # whether they come to rest
    text: str


@dataclass(frozen=True)
class FullLoop:
    """The loop with all effects, sensors and limits, linearised at its rest and tried by simulation."""

    verdict: str  # "stable", "unstable", "off the set-point" or "not judged"
    pole: complex | None  # that grows fastest or decays slowest, 1/s
    text: str  # where that is, or why it was not judged
    offset: dict[str, float] = field(default_factory=dict)  # true pose at rest less set-point, m and rad
    simulated: str = ""  # what simulations from starts in the region came to

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
    zero_dynamics : ZeroDynamics or None
        What becomes of the axes that no thruster pushes.
    not_covered : dict of str
        Effects that no condition knows, with the reason.
    uncertainty : str
        Where the uncertainty of the parameters is from, and its confidence.
    full_loop : FullLoop or None
        The loop with the effects that no condition knows; None where it was not looked at.
    loop_with_observer : FullLoop or None
        The loop in which the law gets the estimate of an observer, linearised; None without one.
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
    zero_dynamics: ZeroDynamics | None = None
    not_covered: dict[str, str] = field(default_factory=dict)
    uncertainty: str = ""
    full_loop: FullLoop | None = None
    loop_with_observer: FullLoop | None = None

    @property
    def satisfied(self) -> bool:
        """Whether every condition that was checked holds, and one iota serves all of its form."""
        verdicts = [r.verdict for r in self.rows] + [a.verdict for a in self.agreements]
        return all(verdict == HOLDS for verdict in verdicts)

    @property
    def conditions_hold(self) -> bool:
        """Whether every condition of every form holds, one iota serves all, and every channel is stable."""
        limit = SETTINGS.slowest_decay if self.zero_dynamics else 0.0  # what nothing pushes stays where it is
        coupled = all(r.real < limit for roots in self.coupled.values() for r in roots)
        return self.satisfied and coupled and all(c.stable for c in self.channels)

    @property
    def ok(self) -> bool:
        """Whether the loop is certified.

        Conditions hold, or a quadratic V or bounds in time were found and proved, and those derived from the
        model need not be asked for then; motions from a region come to rest within the limits of the
        thrusters or, where axes are unactuated, those come to rest; and the loop with all effects is stable
        where there are others, as is the one with an observer, if one was asked for.
        """
        certified = self.zero_dynamics.stable if self.zero_dynamics else self.region.kind != "none"
        held = self.conditions_hold or (self.region.by_search and self._other_conditions_hold)
        loops = all(loop is None or loop.stable for loop in (self.full_loop, self.loop_with_observer))
        return held and certified and loops and self.region.contains_start is not False

    @property
    def _other_conditions_hold(self) -> bool:
        """Whether every condition holds that is not derived from the model."""
        rows = all(r.verdict == HOLDS for r in self.rows if r.form != "derived")
        return rows and all(a.verdict == HOLDS for a in self.agreements if a.form != "derived")

    def __repr__(self) -> str:
        held = sum(row.verdict == HOLDS for row in self.rows)
        verdict = "certified" if self.ok else "not certified"
        return f"{self.gains} on {self.vehicle}: {verdict}; {held} of {len(self.rows)} conditions hold"

    def _repr_html_(self) -> str:
        head = ("form", "statement", "scope", "signs", "left", "right", "margin", "verdict")
        return html(repr(self), head, ([getattr(row, name) for name in head] for row in self.rows))
