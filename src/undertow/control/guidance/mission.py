"""Mission files: way-points, limits, and how they are followed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, StrictStr

from undertow.control.gains import GainSet
from undertow.errors import UndertowError
from undertow.model.symbols import MOTION_UNITS
from undertow.model.tables import FileTable, Quantity, is_file, read_table
from undertow.model.units import si_of

from .curves import SplineOfSight
from .line_of_sight import Guidance, LineOfSight
from .reference import (
    Limits,
    Profile,
    Reference,
    TimedReference,
    fitted,
    spline,
    straight_legs,
    waypoint_times,
)


class WaypointTable(FileTable):
    """One way-point."""

    x: Quantity = 0.0
    y: Quantity = 0.0
    z: Quantity = 0.0
    psi: Quantity | None = None  # else along the way, or the heading of the mission
    t: Quantity | None = None  # when to be there; trajectories only


class LimitTable(FileTable):
    """Limits of the reference."""

    acceleration: Quantity = "0.1 m/s^2"
    turn_rate: Quantity = "20 deg/s"
    turn_acceleration: Quantity = "10 deg/s^2"


class GuidanceTable(FileTable):
    """Line of sight, of legs and splines."""

    lookahead: Quantity = "5 m"
    acceptance: Quantity = "3 m"
    integral: Quantity = "0 m/s"  # sigma of ILOS, against a current; 0 is LOS
    steepest: Quantity = "30 deg"  # pitch


class CurrentTable(FileTable):
    """Current of the simulation, unknown to the controller."""

    north: Quantity = 0.0
    east: Quantity = 0.0


class MissionTable(FileTable):
    """The whole file."""

    schema_: Annotated[Literal["undertow/mission/1"], Field(alias="schema")]
    name: Annotated[StrictStr, Field(min_length=1, max_length=80)]
    description: StrictStr = ""
    kind: Literal["setpoints", "spline", "trajectory", "legs"]
    speed: Quantity
    heading: Quantity | Literal["along"] = "along"
    hold: Quantity = "0 s"  # at every set-point
    limits: LimitTable = Field(default_factory=LimitTable)
    guidance: GuidanceTable | None = None
    current: CurrentTable | None = None
    waypoints: Annotated[list[WaypointTable], Field(min_length=2, max_length=200)]


@dataclass(frozen=True)
class MissionLimits:
    """Limits beyond which a unit is wrong, as no vehicle in water has such a mission, and time to spare."""

    size: float = 1e6  # m and rad, of a way-point
    low: float = 1e-6  # of speeds, accelerations and distances, SI
    high: float = 1e4
    longest: float = 1e7  # s
    closest: float = 1e-3  # way-points of splines and legs, m
    steepest: float = math.radians(85)  # of legs, rad
    rounding: float = 1e-9  # relative, by which a trajectory may exceed its limits
    # Time to simulate: factor on that of the mission, and s more, of legs and of trajectories.
    legs: tuple[float, float] = (1.5, 30.0)
    trajectory: tuple[float, float] = (1.1, 5.0)


LIMITS = MissionLimits()


@dataclass(frozen=True)
class Mission:
    """A mission file in SI."""

    # name, kind: name, and "setpoints", "spline", "trajectory" or "legs"
    name: str
    kind: str
    points: np.ndarray  # (k, 3): way-points x, y, z, m, NED
    headings: tuple[float | None, ...]  # heading at each, rad; None goes along the way
    times: tuple[float | None, ...]  # when to be there, s
    limits: Limits  # speeds and accelerations of the reference
    hold: float  # rest at every set-point, s
    guidance: Guidance  # line of sight; legs use it, and splines of what does not push in sway
    # velocity of the water to the north and to the east in simulations, m/s
    current: tuple[float, float] | None
    has_guidance: bool = False  # whether the file states line of sight, for vehicles that could do without

    @property
    def length(self) -> float:
        """Sum of the distances between way-points, m."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def simulation_time(self, names: tuple[str, ...]) -> float:
        """Time to simulate, with some to spare, s."""
        if self.kind == "legs":
            factor, more = LIMITS.legs
            return factor * self.length / self.limits.speed + more
        factor, more = LIMITS.trajectory
        return factor * self.profile(names).duration + more

    def reference(self, gains: GainSet) -> Reference:
        """What a controller with these gains follows."""
        vehicle = gains.plant.vehicle
        names = vehicle.pose_names
        for i, name in enumerate("xyz"):
            if name not in names and np.any(self.points[:, i]):
                raise UndertowError(
                    f"way-points have {name}, which '{vehicle.name}' does not move in: leave {name} out"
                )
        if not {"x", "y", "psi"} <= set(names):
            raise UndertowError(f"a mission needs x, y and psi, and '{vehicle.name}' has {', '.join(names)}")
        actuated = {
            n for n, d in zip(names, vehicle.degrees_of_freedom, strict=True) if d not in gains.unactuated
        }
        unactuated = [n for n in ("x", "y", "z", "psi") if n in names and n not in actuated]
        if self.kind == "legs" or (self.kind == "spline" and (self.has_guidance or unactuated)):
            return self._line_of_sight(gains, actuated)
        if unactuated:
            raise UndertowError(
                f"a mission of kind '{self.kind}' controls {unactuated[0]}, in which '{vehicle.name}' has no "
                'actuator: write kind = "legs" or "spline", which steer along the heading'
            )
        return TimedReference(self.profile(names))

    def _line_of_sight(self, gains: GainSet, actuated: set[str]) -> LineOfSight:
        """Legs, or a spline, for a vehicle that steers along its heading."""
        vehicle = gains.plant.vehicle
        names = vehicle.pose_names
        _require_steering(self, actuated, vehicle.name)
        pitches = "z" not in actuated and "theta" in actuated
        if "z" in names and not pitches and "z" not in actuated and np.ptp(self.points[:, 2]):
            raise UndertowError(
                f"'{vehicle.name}' pushes neither in heave nor in pitch: give all way-points the same z"
            )
        if self.kind == "spline" and any(h is not None for h in self.headings):
            raise UndertowError(
                f"'{vehicle.name}' steers along the spline, by line of sight: remove psi and heading"
            )
        unactuated = [i for i, d in enumerate(vehicle.degrees_of_freedom) if d in gains.unactuated]
        uncontrolled = tuple(vehicle.velocity_names[i] for i in unactuated)
        make = SplineOfSight if self.kind == "spline" else LineOfSight
        return make(names, self.points, self.limits, self.guidance, pitches, uncontrolled)

    def profile(self, names: tuple[str, ...]) -> Profile:
        """The pose over time of set-points, splines and trajectories in these coordinates."""
        make = {"setpoints": self._setpoints, "spline": self._spline, "trajectory": self._trajectory}
        return make[self.kind](names)

    def _poses(self, names: tuple[str, ...], points: np.ndarray, headings: np.ndarray) -> np.ndarray:
        columns = dict(zip("xyz", points.T, strict=True)) | {"psi": np.unwrap(headings)}
        return np.column_stack([columns.get(n, np.zeros(len(points))) for n in names])

    def _setpoints(self, names: tuple[str, ...]) -> Profile:
        """A turn at the way-point, then the way."""
        points, headings = [self.points[0]], [self.headings[0]]
        for begin, end, stated in zip(self.points[:-1], self.points[1:], self.headings[1:], strict=True):
            north, east = (end - begin)[:2]
            heading = (
                stated if stated is not None else math.atan2(east, north) if north or east else headings[-1]
            )
            headings[0] = heading if headings[0] is None else headings[0]
            points += [begin, end]
            headings += [headings[-1] if stated is not None else heading, heading]
        poses = self._poses(names, np.array(points), np.array(headings, dtype=float))
        return straight_legs(names, list(poses), self.limits, self.hold)

    def _spline(self, names: tuple[str, ...]) -> Profile:
        first = waypoint_times(self.points, np.zeros(len(self.points)), self.limits)
        headings = self._tangent_headings(first)
        times = waypoint_times(self.points, np.unwrap(headings), self.limits)
        return fitted(spline(names, self._poses(names, self.points, headings), times), self.limits)

    def _tangent_headings(self, times: np.ndarray) -> np.ndarray:
        """Heading at every way-point: as given, else that of the curve; the ends have that of their chord."""
        curve = spline(("x", "y", "z"), self.points, times)
        rates = curve.at(times - times[0], 1)
        rates[0], rates[-1] = self.points[1] - self.points[0], self.points[-1] - self.points[-2]
        own = np.arctan2(rates[:, 1], rates[:, 0])
        return np.array([o if h is None else h for o, h in zip(own, self.headings, strict=True)])

    def _trajectory(self, names: tuple[str, ...]) -> Profile:
        missing = [i for i, t in enumerate(self.times) if t is None]
        if missing:
            raise UndertowError(f"way-point {missing[0] + 1} of the trajectory has no time: add t")
        times = np.array(self.times, dtype=float)
        late = np.flatnonzero(np.diff(times) <= 0)
        if late.size:
            raise UndertowError(
                f"way-point {late[0] + 2} has t = {times[late[0] + 1]:g} s, not later than the one before: "
                "times have to increase"
            )
        headings = self._tangent_headings(times)
        found = spline(names, self._poses(names, self.points, headings), times)
        _check_limits(found, self.limits)
        return found


def _check_limits(profile: Profile, limits: Limits) -> None:
    """Refuse a trajectory that exceeds its limits, and say where, and which time it would need."""
    words = {False: ("speed", "m/s"), True: ("turn rate", "rad/s")}
    for angles, (name, unit) in words.items():
        for order, limit in enumerate(limits.of(angles), 1):
            peaks = profile.peaks(order, angles)
            worst = int(np.argmax(peaks))
            if peaks[worst] > limit * (1 + LIMITS.rounding):
                what, by = (name, unit) if order == 1 else (f"{name.split()[0]} acceleration", f"{unit}^2")
                factor = (peaks[worst] / limit) ** (1 / order)
                raise UndertowError(
                    f"{what} of the trajectory is {peaks[worst]:.4g} {by} near t = "
                    f"{profile.knots[worst]:.4g} s, above {limit:.4g}: allow {factor:.3g} times the time, "
                    "or raise the limit"
                )


_KINDS = {"legs": "legs", "spline": "splines by line of sight"}


def _require_steering(mission: Mission, actuated: set[str], vehicle: str) -> None:
    missing = [n for n in ("x", "psi") if n not in actuated]
    if missing:
        what = {"x": "surge", "psi": "yaw"}[missing[0]]
        raise UndertowError(
            f"{_KINDS[mission.kind]} need a force in {what}, which '{vehicle}' does not have; fins and "
            "rudders give one if the gain file has [allocation] speed"
        )
    flat = np.linalg.norm(np.diff(mission.points[:, :2], axis=0), axis=1)
    if (flat < LIMITS.closest).any():
        raise UndertowError(
            f"way-points {int(np.argmin(flat)) + 1} and {int(np.argmin(flat)) + 2} are above each other, "
            f'but {_KINDS[mission.kind]} need a horizontal direction: move one, or write kind = "setpoints"'
        )


def load_mission(source: str | Path) -> Mission:
    """Read a mission file.

    Raises
    ------
    UndertowError
        If it is not a mission file, or one of its numbers is impossible.
    """
    path = Path(source)
    if not is_file(path):
        raise UndertowError(f"mission '{source}' is not a file: give the path of a mission file (TOML)")
    table = read_table(path, MissionTable, "mission file")
    try:
        return mission_from_table(table)
    except UndertowError as error:
        raise UndertowError(f"{path}: {error}") from error


def mission_from_table(table: MissionTable) -> Mission:
    """The mission that a validated file describes."""
    _check_keys(table)
    limits = {"speed": _bounded("speed", table.speed, "m/s")}
    units = {"acceleration": "m/s^2", "turn_rate": "rad/s", "turn_acceleration": "rad/s^2"}
    limits |= {n: _bounded(f"[limits] {n}", getattr(table.limits, n), u) for n, u in units.items()}
    points = np.array([_waypoint(i, w) for i, w in enumerate(table.waypoints, 1)])
    _check_apart(table.kind, points)
    common = None if table.heading == "along" else si_of("heading", table.heading, "rad")
    headings = [
        common if w.psi is None else si_of(f"way-point {i} psi", w.psi, "rad")
        for i, w in enumerate(table.waypoints, 1)
    ]
    times = [
        None if w.t is None else si_of(f"way-point {i} t", w.t, "s") for i, w in enumerate(table.waypoints, 1)
    ]
    hold = si_of("hold", table.hold, "s")
    if not 0 <= hold <= LIMITS.longest:
        raise UndertowError(f"hold = {table.hold}: give a time from 0 to {LIMITS.longest:g} s")
    water = table.current
    current = (
        (si_of("[current] north", water.north, "m/s"), si_of("[current] east", water.east, "m/s"))
        if water
        else None
    )
    guidance = _guidance(table.guidance or GuidanceTable())
    return Mission(
        table.name, table.kind, points, tuple(headings), tuple(times), Limits(**limits),
        hold, guidance, current, table.guidance is not None,
    )  # fmt: skip


def _check_keys(table: MissionTable) -> None:
    """Refuse keys that a mission of this kind does not use."""
    if table.guidance is not None and table.kind not in ("legs", "spline"):
        raise UndertowError(
            f"[guidance] is for kind = 'legs' or 'spline', and this is '{table.kind}': remove it"
        )
    timed = [i for i, w in enumerate(table.waypoints, 1) if w.t is not None]
    if timed and table.kind != "trajectory":
        raise UndertowError(
            f"way-point {timed[0]} has a time, which kind = '{table.kind}' does not use: remove t, or write "
            'kind = "trajectory"'
        )
    turned = [i for i, w in enumerate(table.waypoints, 1) if w.psi is not None]
    if table.kind == "legs" and (turned or table.heading != "along"):
        raise UndertowError("legs use the heading of the line of sight: remove psi and heading")


def _guidance(table: GuidanceTable) -> Guidance:
    sizes = {n: _bounded(f"[guidance] {n}", getattr(table, n), "m") for n in ("lookahead", "acceptance")}
    integral = si_of("[guidance] integral", table.integral, "m/s")
    steepest = si_of("[guidance] steepest", table.steepest, "rad")
    if not 0 <= integral <= LIMITS.high:
        raise UndertowError(
            f"[guidance] integral = {table.integral}: give 0 m/s (LOS) or a value above it (ILOS)"
        )
    if not 0 < steepest < LIMITS.steepest:
        raise UndertowError(f"[guidance] steepest = {table.steepest}: give an angle above 0 and below 85 deg")
    return Guidance(**sizes, integral=integral, steepest=steepest)


def _check_apart(kind: str, points: np.ndarray) -> None:
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if kind in ("spline", "legs") and (gaps < LIMITS.closest).any():
        i = int(np.argmin(gaps)) + 1
        raise UndertowError(
            f"way-points {i} and {i + 1} are {gaps[i - 1]:g} m apart: a {kind.rstrip('s')} needs "
            f"{LIMITS.closest:g} m at least; remove one"
        )


def _waypoint(i: int, point: WaypointTable) -> list[float]:
    found = [si_of(f"way-point {i} {n}", getattr(point, n), MOTION_UNITS[n]) for n in "xyz"]
    if max(map(abs, found)) > LIMITS.size:
        raise UndertowError(f"way-point {i} is beyond {LIMITS.size:g} m: check the unit")
    return found


def _bounded(what: str, stated: Quantity, unit: str) -> float:
    value = si_of(what, stated, unit)
    if not LIMITS.low <= value <= LIMITS.high:
        raise UndertowError(f"{what} = {stated}: give one from {LIMITS.low:g} to {LIMITS.high:g} {unit}")
    return value
