"""Line of sight along splines: nearest points, straight splines against legs, circles, a torpedo."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from tests.control.test_missions import EXAMPLES, LIMITS, mission, ship
from undertow.control.closed_loop import ClosedLoop, Overrides, Scenario
from undertow.control.conditions.tracking import check_mission
from undertow.control.controller import Controller
from undertow.control.gains import GainSet, load_gains
from undertow.control.guidance.curves import SplineOfSight
from undertow.control.guidance.line_of_sight import Guidance, LineOfSight
from undertow.control.guidance.mission import load_mission
from undertow.control.guidance.reference import Kinematics, Limits, TimedReference
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle

WINDING = EXAMPLES / "remus100-spline.toml"
SIGHT = {"lookahead": 5.0, "acceptance": 1.0, "integral": 0.2}
BOW = [{"x": 0.0, "y": 0.0}, {"x": 10.0, "y": 4.0}, {"x": 20.0, "y": 0.0}]


@pytest.fixture(scope="module")
def remus() -> GainSet:
    return load_gains(EXAMPLES / "remus100-gains.toml", load_vehicle("remus100"))


def circle(radius: float, limits: Limits, guidance: Guidance) -> SplineOfSight:
    """Three quarters of a circle about the origin, to starboard."""
    angles = np.linspace(0, 1.5 * np.pi, 25)
    points = radius * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    return SplineOfSight(("x", "y", "psi"), points, limits, guidance, False)


def particle(guide: LineOfSight, start: np.ndarray, seconds: float, dt: float = 0.02) -> np.ndarray:
    """Places over time of a vehicle that has the heading and speed asked for, shape (n, 2)."""
    eta, nu, s = ca.SX.sym("eta", 3), ca.SX.sym("nu", 3), ca.SX.sym("s", len(guide.state_names))
    r = ca.DM([n.value for n in guide.numbers])
    kin = Kinematics(("x", "y", "psi"), eta, nu, ca.SX.eye(3), ca.SX.zeros(3, 3))
    course = guide.desired(r, s, kin)
    after = guide.advance(r, s, kin, ca.SX(dt))
    step = ca.Function("step", [eta, nu, s], [course.eta_d[2], course.nu_r[0], after])
    pose, states, rows = start.copy(), np.array(guide.initial_states()), []
    speed = guide.limits.speed
    for _ in range(round(seconds / dt)):
        psi, asked, states = (np.asarray(v).ravel() for v in step(pose, [speed, 0, 0], states))
        pose += [dt * asked[0] * math.cos(psi[0]), dt * asked[0] * math.sin(psi[0]), psi[0] - pose[2]]
        rows.append(pose[:2].copy())
    return np.array(rows)


def test_a_circle_is_followed_without_error_although_the_heading_is_slow() -> None:
    """Without the rate of the course the heading would lag 2 / quick times it, 3 m off the path."""
    slow = Limits(1.0, 0.5, 0.4, 0.16)
    quick, radius = 0.16 / (2 * 0.4), 50.0
    guide = circle(radius, slow, Guidance(15.0, 1.0))
    assert guide.curvatures[500:700] == pytest.approx(1 / radius, rel=5e-3)
    start = np.array([radius, 0.0, guide.start[2]])
    off = np.linalg.norm(particle(guide, start, 150.0), axis=1) - radius
    assert np.abs(off[5500:]).max() < 0.01  # the turn begins from rest
    assert 15.0 * math.tan(2 / quick / radius) > 3.0


def test_the_place_on_the_path_is_the_nearest_point(remus: GainSet) -> None:
    guide = load_mission(WINDING).reference(remus)
    assert isinstance(guide, SplineOfSight)
    w = np.linspace(0, guide.knots[-1], 20_001)
    path, random = guide.curve(w), np.random.default_rng(4)
    first = random.uniform(20, guide.knots[-1] - 20, 30)
    tangent = guide.curve(first, 1)[:, :2]
    aside = np.column_stack([-tangent[:, 1], tangent[:, 0]]) * random.uniform(-5, 5, (30, 1))
    places = guide.curve(first) + np.column_stack([aside, random.normal(size=30)])
    # The foot of the sample before is half a metre back.
    states = {n: np.zeros(30) for n in guide.state_names} | {"path": first - 0.5}
    found = guide._positions(states, list(places.T))
    flat = np.linalg.norm(path[:, None, :2] - places[None, :, :2], axis=2)
    assert found.along == pytest.approx(w[flat.argmin(axis=0)], abs=0.03)
    assert np.abs(found.cross) == pytest.approx(flat.min(axis=0), abs=1e-3)


def test_a_straight_spline_is_a_leg() -> None:
    gains, random = ship("pid"), np.random.default_rng(1)
    ends = [{"x": 0.0, "y": 0.0}, {"x": 30.0, "y": 10.0}]
    leg, spline = (
        Controller(gains, mission(kind, ends, guidance=SIGHT).reference(gains)) for kind in ("legs", "spline")
    )
    states = [np.array(c.initial_states()) for c in (leg, spline)]
    for k in range(50):
        y = np.concatenate([[0.4 * k, 0.1 * k], random.normal(size=4)])
        forces = []
        for i, c in enumerate((leg, spline)):
            u, states[i], _ = c.sampled(y, c.mission_numbers, states[i], c.gain_values(), 0.1)
            forces.append(np.asarray(u).ravel())
        assert forces[0] == pytest.approx(forces[1], abs=1e-10)
    own = [list(c.state_names).index("cross_integral") for c in (leg, spline)]
    assert float(states[0][own[0]]) == pytest.approx(float(states[1][own[1]]), abs=1e-10)


@pytest.mark.parametrize("north", [0.0, 0.3])
def test_a_torpedo_with_fins_keeps_to_a_spline_across_a_current(north: float, remus: GainSet) -> None:
    winding = replace(load_mission(WINDING), current=(0.0, north))
    loop = ClosedLoop(
        remus, Overrides(current=winding.current).in_current(remus.plant.vehicle), mission=winding
    )
    guide = winding.reference(remus)
    start = (*map(float, guide.start[:3]), float(guide.start[-1]))
    record = loop.run(Scenario(duration=190.0, dt=0.05, start=start, moving={"u": 1.5}))
    assert record.followed is not None
    assert record.followed.arrived[-1]
    under_way = ~record.followed.arrived
    late = under_way & (record.t > 90)  # once the side-slip of the current is learned
    errors = record.followed.errors
    assert np.abs(errors["cross track"][late]).max() < 0.6
    assert np.abs(errors["depth"][late]).max() < 0.2
    assert np.abs(errors["cross track"][under_way]).max() < 3.1  # what LOS without the integral keeps
    last = np.array([record.state[n][np.argmax(record.followed.arrived)] for n in "xy"])
    assert np.linalg.norm(last - guide.curve(guide.knots[-1])[:2]) < 2.5


def test_guidance_in_the_file_is_asked_for_by_what_pushes_in_sway() -> None:
    """Without it the spline has its times, and a pose is held."""
    gains = ship("pd")
    assert isinstance(mission("spline", BOW).reference(gains), TimedReference)
    sighted = mission("spline", BOW, guidance=SIGHT)
    record = ClosedLoop(gains, mission=sighted).run(Scenario(duration=90.0, dt=0.05))
    assert record.followed is not None
    assert record.followed.arrived[-1]
    assert np.abs(record.followed.errors["cross track"][record.t > 20]).max() < 0.3


@pytest.mark.slow
def test_tangents_are_certified_as_legs_are(remus: GainSet) -> None:
    found = check_mission(remus, load_mission(WINDING))
    assert found.ok
    assert [row.condition for row in found.rows][:3] == ["current", "bends", "tangent at way-point 1"]
    assert len(found.rows) == 6


@pytest.mark.parametrize(
    ("points", "more", "complaint"),
    [
        (BOW, {"limits": {**LIMITS, "turn_rate": 0.02}}, "has a radius of .* m between way-points"),
        (BOW, {"heading": 0.0}, "remove psi and heading"),
        (
            [{}, {"z": 0.01}, {"x": 5.0, "z": 9.0}],
            {},
            "force in surge|no horizontal direction|above each other",
        ),
    ],
)
def test_a_spline_that_cannot_be_steered_is_refused(points: list, more: dict, complaint: str) -> None:
    gains = ship("pd") if points is BOW else load_gains("paper-pd", load_vehicle("mini-auv"))
    with pytest.raises(UndertowError, match=complaint):
        mission("spline", points, guidance=SIGHT, **more).reference(gains)
