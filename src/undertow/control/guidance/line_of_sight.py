"""Line-of-sight guidance along straight legs, with integral action against a current."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from undertow.codegen.functions import wrapped

from .reference import DesiredMotion, Followed, Kinematics, Limits, MissionNumber, Reference


@dataclass(frozen=True)
class Guidance:
    """The numbers of line-of-sight guidance."""

    lookahead: float  # distance ahead on the leg that the vehicle is steered for, m
    acceptance: float  # distance from the end of a leg at which the next one begins, m
    # Integral action sigma, m/s: 0 is LOS without it. The side-slip that a current asks for is learned in
    # some lookahead / integral seconds.
    integral: float = 0.0
    steepest: float = math.radians(30)  # largest angle of pitch that is asked for, rad


class Leg(NamedTuple):
    """Position of a vehicle relative to its leg, SX or arrays."""

    course: ca.SX  # direction of the leg, rad
    incline: ca.SX  # angle of the leg above the horizontal, rad
    along: ca.SX  # gone of it in the plane, m
    length: ca.SX  # in the plane, m
    cross: ca.SX  # to starboard of it, m
    below: ca.SX  # deeper than it, at right angles to it, m
    to_end: ca.SX  # distance to its end, m
    depth: ca.SX  # of the leg here, m
    # bend, rise: change of course and incline for each metre of way in the plane, rad/m; zero if straight
    curvature: ca.SX = 0
    incline_rate: ca.SX = 0


class LineOfSight(Reference):
    """Straight legs between way-points for a vehicle that steers along its heading.

    With the cross-track error e and lookahead D, the heading is chi - atan((e + sigma e_int) / D) and
    e_int_dot = D e / ((e + sigma e_int)^2 + D^2), which grows slowly far from the leg. A vehicle
    that dives by pitching has the same in the vertical plane; another one follows the depth of the leg. At a
    turn into the next leg e_int is multiplied by the cosine of the turn, as the steady current across a leg
    is: the law is stated for one leg. The integral of the vertical plane, which holds trim, goes on.
    Heading and pitch pass a model of second order with limited rate and acceleration, the speed one of first.
    The position itself is not held: errors of x and y are zero, and surge has the speed as its reference.

    Source: Borhaug, Pavlov and Pettersen (2008), Integral LOS control for path following of underactuated
    marine surface vessels in the presence of constant ocean currents, CDC; Fossen (2021), chapter 12.
    """

    state_names: ClassVar[tuple[str, ...]] = (
        *("leg", "arrived", "started", "cross_integral", "depth_integral"),
        *("heading", "heading_rate", "pitch", "pitch_rate", "speed"),
    )

    def __init__(
        self,
        names: tuple[str, ...],
        points: np.ndarray,
        limits: Limits,
        guidance: Guidance,
        pitches: bool,
        uncontrolled: tuple[str, ...] = (),
    ) -> None:
        self.names, self.points, self.limits, self.guidance = names, points, limits, guidance
        self.pitches, self.uncontrolled = pitches, uncontrolled
        pose = {n: np.zeros(len(points)) for n in names} | {
            n: points[:, i] for i, n in enumerate("xyz") if n in names
        }
        courses = self._course_angles()
        self.start, self.end = (
            np.array([pose[n][i] if n != "psi" else courses[i] for n in names]) for i in (0, -1)
        )
        self._check()

    def _check(self) -> None:
        """Refuse a path that cannot be followed; legs can, whatever their length."""

    def _course_angles(self) -> np.ndarray:
        """Courses along the path, rad, from that at its start to that at its end."""
        north, east, _ = np.diff(self.points, axis=0).T
        return np.asarray(np.arctan2(east, north))

    @property
    def numbers(self) -> list[MissionNumber]:
        """The way-points, then speed, limits and the numbers of the guidance."""
        values = {**vars(self.limits), **vars(self.guidance)}
        units = {
            "speed": "m/s",
            "acceleration": "m/s^2",
            "turn_rate": "rad/s",
            "turn_acceleration": "rad/s^2",
        }
        units |= {"lookahead": "m", "acceptance": "m", "integral": "m/s", "steepest": "rad"}
        return self._path_numbers + [MissionNumber(n, units[n], float(values[n])) for n in units]

    @property
    def _path_numbers(self) -> list[MissionNumber]:
        """Numbers of the path."""
        return [
            MissionNumber(f"{c}_{i}", "m", float(v))
            for i, p in enumerate(self.points)
            for c, v in zip("xyz", p, strict=True)
        ]

    def initial_states(self) -> list[float]:
        """Before the first sample, which takes heading, pitch and speed as they are."""
        return [0.0] * len(self.state_names)

    # --- the functions ------------------------------------------------------------------------
    def desired(self, r: ca.SX, s: ca.SX, kin: Kinematics) -> DesiredMotion:
        """The attitude and speed that the models have come to; the position as it is."""
        state, accelerations = self._state(s, kin), self._accelerations(r, s, kin)
        leg = self._leg(r, s, kin)
        n = len(kin.names)
        eta_d, rate, acceleration = ca.SX(kin.eta), ca.SX.zeros(n, 1), ca.SX.zeros(n, 1)
        states = {"psi": "heading"} | ({"theta": "pitch"} if self.pitches else {})
        for angle in (a for a in ("phi", "theta", "psi") if a in kin.names):
            i, model = kin.index(angle), states.get(angle)
            eta_d[i] = state[model] if model else 0
            rate[i] = state[f"{model}_rate"] if model else 0
            acceleration[i] = accelerations[model] if model else 0
        nu_r = kin.J_inverse @ rate
        nu_r_dot = kin.J_inverse @ (acceleration - kin.J_dot @ nu_r)
        if "z" in kin.names and not self.pitches:
            eta_d[kin.index("z")] = leg.depth
            nu_r[kin.index("z")] = -state["speed"] * ca.tan(leg.incline)
        nu_r[kin.index("x")], nu_r_dot[kin.index("x")] = state["speed"], accelerations["speed"]
        return DesiredMotion(eta_d, nu_r, nu_r_dot)

    def advance(self, r: ca.SX, s: ca.SX, kin: Kinematics, dt: ca.SX) -> ca.SX:
        """Legs, integrals and models one sample on."""
        state, accelerations, leg = self._state(s, kin), self._accelerations(r, s, kin), self._leg(r, s, kin)
        value = self._values(r)
        integrals = {}
        for name, error in (("cross_integral", leg.cross), ("depth_integral", leg.below)):
            aim = error + value["integral"] * state[name]
            gain = value["lookahead"] * error / (aim**2 + value["lookahead"] ** 2)
            integrals[name] = state[name] + dt * gain
        progress, kept = self._progress(r, s, kin, leg)
        integrals["cross_integral"] *= kept
        later = {
            **progress,
            "started": ca.SX(1),
            **integrals,
            "speed": state["speed"] + dt * accelerations["speed"],
        }
        for name in ("heading", "pitch"):
            later[f"{name}_rate"] = state[f"{name}_rate"] + dt * accelerations[name]
            later[name] = state[name] + dt * later[f"{name}_rate"]
        return ca.vertcat(*[later[n] for n in self.state_names])

    def _progress(self, r: ca.SX, s: ca.SX, kin: Kinematics, leg: Leg) -> tuple[dict[str, ca.SX], ca.SX]:
        """The leg that comes next and whether the end is reached; the share of the integral that stays."""
        state, value = self._state(s, kin), self._values(r)
        reached = ca.logic_or(leg.to_end <= value["acceptance"], leg.along >= leg.length)
        last = state["leg"] >= len(self.points) - 2
        same_leg = 1 - ca.logic_and(reached, ca.logic_not(last))
        # What is known of a current is its part across the old leg: this is what of it is across the new one.
        following = self._leg(r, ca.vertcat(state["leg"] + 1, s[1:]), kin)
        progress = {
            "leg": state["leg"] + (1 - same_leg),
            "arrived": ca.fmax(state["arrived"], ca.logic_and(reached, last)),
        }
        return progress, ca.if_else(same_leg, 1, ca.cos(following.course - leg.course))

    def _state(self, s: ca.SX, kin: Kinematics) -> dict[str, ca.SX]:
        """States by name; at the first sample heading, pitch and speed are those reported."""
        state = dict(zip(self.state_names, ca.vertsplit(s), strict=True))
        reported = {"heading": kin.eta[kin.index("psi")], "speed": kin.nu[kin.index("x")]}
        if "theta" in kin.names:
            reported["pitch"] = kin.eta[kin.index("theta")]
        return state | {n: ca.if_else(state["started"] > 0, state[n], v) for n, v in reported.items()}

    def _values(self, r: ca.SX) -> dict[str, ca.SX]:
        count = len(self._path_numbers)
        names = (*vars(self.limits), *vars(self.guidance))
        return dict(zip(names, ca.vertsplit(r[count:]), strict=True))

    def _leg(self, r: ca.SX, s: ca.SX, kin: Kinematics) -> Leg:
        count = len(self.points)
        points = ca.reshape(r[: 3 * count], 3, count)
        selected = ca.vertcat(*[s[0] == i for i in range(count - 1)])
        begin, end = points[:, :-1] @ selected, points[:, 1:] @ selected
        places = [kin.eta[kin.index(c)] if c in kin.names else ca.SX(0) for c in "xyz"]
        return relative_to_leg(ca, begin, end, places)

    def _accelerations(self, r: ca.SX, s: ca.SX, kin: Kinematics) -> dict[str, ca.SX]:
        """Accelerations of the models of heading, pitch and speed."""
        state, leg, value = self._state(s, kin), self._leg(r, s, kin), self._values(r)
        cross_slope = (leg.cross + value["integral"] * state["cross_integral"]) / value["lookahead"]
        depth_slope = (leg.below + value["integral"] * state["depth_integral"]) / value["lookahead"]
        desired = {
            "heading": leg.course - ca.atan(cross_slope),
            "pitch": _clipped(leg.incline + ca.atan(depth_slope), value["steepest"]),
        }
        # Critically damped, and slow enough that a turn from its largest rate needs no more than the limit.
        bandwidth = value["turn_acceleration"] / (2 * value["turn_rate"])
        feed_forward = {
            "heading": leg.curvature * _speed_along(leg, kin),
            "pitch": leg.incline_rate * _speed_along(leg, kin),
        }
        found = {}
        for name, target in desired.items():
            # Cut off here, the rate tends to its limit and never passes it.
            error = wrapped(target - state[name])
            rate = _clipped(bandwidth * error / 2 + feed_forward[name], value["turn_rate"])
            found[name] = _clipped(2 * bandwidth * (rate - state[f"{name}_rate"]), value["turn_acceleration"])
        speed = (1 - state["arrived"]) * value["speed"] - state["speed"]
        found["speed"] = _clipped(bandwidth * speed, value["acceleration"])
        return found

    # --- beside a run -------------------------------------------------------------------------
    def followed(self, t: np.ndarray, state: dict[str, np.ndarray], s: np.ndarray) -> Followed:
        """Heading, pitch and depth that were asked for, and how far off the path the vehicle was."""
        named = dict(zip(self.state_names, s.T, strict=True))
        found = self._positions(named, [state.get(c, np.zeros(len(t))) for c in "xyz"])
        desired = {"psi": named["heading"], "z": found.depth, "u": named["speed"]}
        if self.pitches:
            desired["theta"] = named["pitch"]
        errors = {"cross track": -found.cross}
        if "z" in self.names:
            errors["depth"] = -found.below
        known = {n: v for n, v in desired.items() if n in state}
        return Followed(known, errors, named["arrived"] > 0, self.path)

    @property
    def path(self) -> np.ndarray:
        """The path in the plane, shape (k, 2)."""
        return self.points[:, :2]

    def _positions(self, named: dict[str, np.ndarray], places: list[np.ndarray]) -> Leg:
        """Position relative to the path over rows."""
        leg = named["leg"].astype(int)
        return relative_to_leg(np, self.points[leg].T, self.points[leg + 1].T, places)


def _speed_along(leg: Leg, kin: Kinematics) -> ca.SX:
    """Speed over ground along the path in the plane, of a level vehicle."""
    aside = kin.eta[kin.index("psi")] - leg.course
    sway = kin.nu[kin.index("y")] if "y" in kin.names else 0
    return kin.nu[kin.index("x")] * ca.cos(aside) - sway * ca.sin(aside)


def _clipped(value: ca.SX, most: ca.SX) -> ca.SX:
    return ca.fmax(-most, ca.fmin(most, value))


def relative_to_leg(m, begin, end, place) -> Leg:  # type: ignore[no-untyped-def]
    """Position relative to the leg from begin to end, in CasADi or NumPy (`m`)."""
    north, east, down = (end[i] - begin[i] for i in range(3))
    length = m.sqrt(north**2 + east**2)
    course, incline = m.arctan2(east, north), -m.arctan2(down, length)
    x, y, z = (place[i] - begin[i] for i in range(3))
    along = (north * x + east * y) / length
    cross = (north * y - east * x) / length
    share = m.fmax(0, m.fmin(1, along / length))
    below = z - share * down
    to_end = m.sqrt((north - x) ** 2 + (east - y) ** 2 + (down - z) ** 2)
    return Leg(course, incline, along, length, cross, below * m.cos(incline), to_end, begin[2] + share * down)
