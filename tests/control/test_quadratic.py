"""A quadratic V from a semidefinite program: what is proved holds against the model, and no more is said."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import sympy as sm

from tests.control.test_certificates import HEAVE, law, loaded, sinker
from tests.control.test_uncertain import STRONG, thick_water
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.control.closed_loop import ClosedLoop, Scenario
from undertow.control.conditions.attitude import Interval, enclose
from undertow.control.conditions.definite import MatrixBudget, sums_positive
from undertow.control.conditions.embedding import proved_positive_definite
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.problem import Problem
from undertow.control.conditions.program import SETTINGS, Program, SpeedBox
from undertow.control.conditions.quadratic import QuadraticSearch
from undertow.control.conditions.region import region
from undertow.control.conditions.result import Quadratic
from undertow.control.gains import GainSet, GainTable, gains_from_table, load_gains
from undertow.control.laws import LawSignals
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle

pytest.importorskip("clarabel")
UNEQUAL = STRONG | {"K_P_y": 1.2, "K_I_psi": 2.0}
START = {"x": 0.3, "y": 0.2, "z": 0.3, "psi": 0.3}


def rates(problem: Problem, way: dict[sm.Symbol, int], states: np.ndarray) -> np.ndarray:
    """Derivative of (heading, error, integral, nu) from the law and the model themselves, one direction."""
    plant, gains = problem.plant, problem.gains
    s = LawSignals(plant, gains.law)
    net = gains.law.force(s) - (plant.C + plant.D) * plant.nu - plant.g
    numbers = {**plant.numbers, **gains.numbers}
    parts = [plant.J * plant.nu, net, gains.law.rates(s), plant.M]
    psi = plant.eta[3]
    names = [psi, *s.error, *s.states, *plant.nu]
    turn, force, integral, M = (
        sm.lambdify(names, plant.with_signs(sm.Matrix(p), way).xreplace(numbers), "numpy") for p in parts
    )
    found = []
    for z in states:
        rate = turn(*z)[:, 0]
        nu_dot = np.linalg.solve(M(*z), force(*z)[:, 0])
        found.append(np.concatenate([[rate[3]], -rate, integral(*z)[:, 0], nu_dot]))
    return np.array(found)


def value(found: Quadratic, states: np.ndarray) -> np.ndarray:
    """V by (heading, error, integral, nu): translations turn by the heading alone; P is the set-point's."""
    psi, error, integral, nu = states[:, 0], states[:, 1:5], states[:, 5:9], states[:, 9:]
    turn = np.tile(np.eye(4), (len(psi), 1, 1))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(psi)
    turn[:, 0, 1], turn[:, 1, 0] = -np.sin(psi), np.sin(psi)
    if found.frame == "body":
        back = np.swapaxes(turn, 1, 2)
        parts = [np.einsum("kij,kj->ki", back, integral), np.einsum("kij,kj->ki", back, error), nu]
    else:
        parts = [integral, error, np.einsum("kij,kj->ki", turn, nu)]
    z = np.concatenate(parts, axis=1)
    P = np.array([found.at(goal) for goal in psi + error[:, 3]])
    return np.asarray(np.einsum("ki,kij,kj->k", z, P, z))


@pytest.mark.parametrize(("gains", "frame"), first_quick([(STRONG, "body"), (UNEQUAL, "earth")]))
def test_v_falls_along_the_model_from_every_state_below_its_level(
    gains: dict[str, float], frame: str
) -> None:
    """Random states and headings on and below V = 1, V_dot by differences of the law and the model."""
    problem = thick_water(gains, 50.0 if frame == "body" else 5.2)
    start = {c: e if frame == "body" else 0.3 * e for c, e in START.items()}
    found = region(problem, False, start)
    assert found.quadratic is not None
    assert (found.quadratic.frame, found.contains_start) == (frame, True)
    _assert_falls(problem, found.quadratic)


def _assert_falls(problem: Problem, found: Quadratic) -> None:
    rng, count = np.random.default_rng(8), 500
    states = rng.normal(size=(count, 13)) * (rng.random((count, 13)) < rng.choice([0.2, 1.0], (count, 1)))
    states[:, 5:9] *= 20
    states[:, 0] = rng.uniform(-np.pi, np.pi, count)
    states[:, 1] += 1e-3  # no state is zero
    share = rng.choice([0.999, 0.5, 0.01], count)
    states[:, 1:] *= np.sqrt(share / value(found, states))[:, None]
    assert np.all(np.abs(states[:, 9:]) <= found.speeds)
    for sign in (1, -1):
        way = dict.fromkeys(problem.plant.reversing, sign)
        own = states.copy()
        own[:, 9:] = sign * np.abs(own[:, 9:])
        own = own[value(found, own) < 1]
        step = 1e-6 * rates(problem, way, own)
        assert np.all(value(found, own + step) < value(found, own - step))


def test_the_start_box_is_below_the_level_at_every_heading() -> None:
    for gains in (STRONG, UNEQUAL):
        found = region(thick_water(gains, 5.2), False, {c: 0.3 * e for c, e in START.items()})
        rng = np.random.default_rng(2)
        states = np.zeros((500, 13))
        states[:, 0] = rng.uniform(-np.pi, np.pi, 500)
        states[:, 1:5] = rng.choice((-1.0, 1.0), (500, 4)) * 0.3 * np.array(list(START.values()))
        assert found.quadratic is not None
        heights = value(found.quadratic, states)
        assert np.all(heights <= found.quadratic.start * (1 + 1e-6))
        assert found.quadratic.start < 1


def test_the_published_surge_loop_gets_no_v() -> None:
    """Routh refuses it: so does the search, whatever the start."""
    problem = Problem(load_gains("paper-pid", load_vehicle("mini-auv")))
    found = region(problem, False, dict.fromkeys(START, 0.02))
    assert (found.kind, found.contains_start) == ("none", False)
    assert "not stable" in found.text


@pytest.mark.slow
def test_commands_stay_below_their_bounds_from_the_start_box() -> None:
    gains = law(sinker(16.2), "pid")
    start = {"x": 0.4, "y": 0.4, "z": 0.4, "psi": 0.4}
    report = certify(gains, forms=["derived"], start=start)
    assert report.ok
    (command,) = report.region.commands
    assert command.largest <= command.limit
    corners = np.random.default_rng(3).choice((-1.0, 1.0), (12, 4)) * list(start.values())
    runs = ClosedLoop(gains).run_many(
        Scenario((0, 0, 0, 0), 300.0, 0.02), starts=dict(zip(start, corners.T, strict=True))
    )
    assert np.abs(runs.command("f1")).max() <= command.largest
    assert np.abs(runs.states[:, -1, :4]).max() < 0.05
    most = np.abs(runs.states[..., :4]).max(axis=(0, 1))
    assert np.all(most <= list(report.region.errors.values()))


def test_a_start_that_asks_for_more_than_a_thruster_has_is_refused() -> None:
    """14.3 N of weight and K_P z = 2 N/m times 2 m: 18.3 N of 16.2 N."""
    report = certify(law(sinker(16.2), "pid"), forms=["derived"], start={"z": 2.0})
    assert not report.ok
    assert report.region.contains_start is False
    assert "the start asks 18.3 of f1, whose limit is 16.2" in report.region.text


def test_pd_says_whether_its_own_level_holds_the_start() -> None:
    """V = K_P e^2/2 against the level; everywhere holds every start."""
    assert certify(law(sinker(), "pd"), forms=["derived"], start={"x": 50.0}).region.contains_start
    report = certify(law(sinker(40.0), "sliding-mode"), forms=["derived"], start={"z": 1e3})
    assert report.region.contains_start is False
    assert not report.ok


def test_positive_definite_is_said_only_where_it_is() -> None:
    """A Gram matrix of whole numbers has no rounding: with a shift of 0 it is singular, else definite."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        thin = rng.integers(-9, 10, (6, 5)).astype(float)
        singular = thin @ thin.T
        assert not proved_positive_definite(enclose(singular[None]))
        assert proved_positive_definite(enclose((singular + 1e-6 * np.eye(6))[None]))
        wide = np.full((6, 6), 1e-6)
        shifted = singular + 1e-6 * np.eye(6)
        assert not proved_positive_definite(Interval((shifted - wide)[None], (shifted + wide)[None]))


@pytest.mark.parametrize("counts", [(2, 3), (3, 4, 2)])
def test_sums_are_positive_only_where_each_of_them_is(counts: tuple[int, ...]) -> None:
    """Against every sum on its own, near the border: none is said positive that is not."""
    rng, n, rows = np.random.default_rng(4), 6, 200
    ends = []
    for count in counts:
        some = rng.normal(size=(2, count, n, n))
        some[:, -1] = -some[:, 0]
        ends.append(0.5 * (some + np.swapaxes(some, -1, -2)))
    place = np.arange(rows) % 2
    sums = [sum(e[:, k] for e, k in zip(ends, ways, strict=True)) for ways in product(*map(range, counts))]
    worst = np.min([np.linalg.eigvalsh(s)[:, 0] for s in sums], axis=0)[place]
    off = rng.uniform(-0.2, 0.2, rows)
    rest = enclose((off - worst)[:, None, None] * np.eye(n))
    found = sums_positive(rest, place, [enclose(e) for e in ends], np.arange(rows), MatrixBudget(10**6))
    np.testing.assert_array_equal(found[np.abs(off) > 1e-3], off[np.abs(off) > 1e-3] > 0)
    pairs = sums_positive(rest, place, [enclose(e) for e in ends], np.arange(rows) // 2, MatrixBudget(10**6))
    np.testing.assert_array_equal(pairs, found.reshape(-1, 2).all(axis=1))
    wide = Interval(rest.lo - 0.02 / n, rest.hi + 0.02 / n)  # takes 0.02 at most, and 0.02 of the sum of all
    left = sums_positive(wide, place, [enclose(e) for e in ends], np.arange(rows), MatrixBudget(10**6))
    assert not left[off < 0.015].any()
    assert left[off > 0.03].all()
    few = sums_positive(rest, place, [enclose(e) for e in ends], np.arange(rows), MatrixBudget(10))
    assert not few.any()


@pytest.mark.parametrize(
    ("start", "reported"),
    [
        ("x:1", "write NAME=VALUE"),
        ("q=1", "'q' is not a coordinate"),
        ("x=-1", "not the size of an error"),
        ("x=0", "zero"),
    ],
)
def test_a_start_that_is_none_is_bad_input(
    start: str, reported: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["gains", "mini-auv", "paper-pd", "--form", "derived", "--start", start]) == 2
    assert reported in " ".join(capsys.readouterr().err.split())


def test_a_start_of_a_coordinate_that_the_vehicle_has_not_is_reported() -> None:
    with pytest.raises(UndertowError, match="'theta' is not a coordinate of the pose"):
        certify(law(sinker(), "pd"), start={"theta": 0.1})


def test_a_region_that_was_not_searched_for_has_no_verdict_on_starts() -> None:
    found = certify(law(sinker(), "pid"), forms=["derived"]).region
    assert found.quadratic is not None
    assert found.contains_start is None


@pytest.mark.slow
def test_pid_in_six_degrees_of_freedom_is_proved() -> None:
    """Position and attitude of the bundled ROV; an integral gain beyond Routh's limit gets no region.

    The region may come from a quadratic V or from bounds in time.
    """
    rov = load_vehicle("bluerov2")
    each = ("x", "y", "z", "phi", "theta", "psi")

    def gains(K_I: float) -> GainSet:
        columns = {"K_P": (25.0, 2.0), "K_V": (50.0, 2.0), "K_I": (K_I, 0.3)}
        chosen = {k: {c: pair[i > 2] for i, c in enumerate(each)} for k, pair in columns.items()}
        table = {"schema": "undertow/gains/1", "name": "rov-pid", "law": "pid", "gains": chosen}
        table["allocation"] = {"limits": {f"f{i}": "40 N" for i in range(1, 9)}}
        return gains_from_table(GainTable.model_validate(table), rov)

    start = {"x": 0.05, "psi": 0.05}
    found = certify(gains(2.0), forms=["derived"], start=start).region
    assert found.contains_start
    assert not certify(gains(200.0), forms=["derived"], start=start).region.contains_start


# --- products of velocities -----------------------------------------------------------------------------
def _program(gains: GainSet, start: dict[str, float]) -> Program:
    looked = QuadraticSearch(Problem(gains, np.pi / 3), start)
    speeds = np.full(looked.loop.n, 0.3)
    return Program(looked, SpeedBox(speeds, dict.fromkeys(looked.loop.angles, 0.3)))


def test_what_may_be_added_to_the_fall_of_v_vanishes_at_every_motion() -> None:
    """sum over k of nu_k z' N_k z = 0 for z = (..., nu), of each N; none of them is a sum of the others."""
    forms = _program(law(sinker(), "pid"), START).identities
    z = np.random.default_rng(1).normal(size=(50, forms.shape[-1]))
    np.testing.assert_allclose(np.einsum("sk,mkij,si,sj->ms", z[:, -4:], forms, z, z), 0, atol=1e-12)
    assert np.linalg.matrix_rank(forms.reshape(len(forms), -1)) == len(forms) > 0


def test_products_read_in_other_ways_hold_a_larger_start() -> None:
    """With A as it stands no V of these speeds holds a box of 0.3 m and rad; with other readings one does."""
    start = dict.fromkeys(("x", "y", "z", "psi"), 0.3)
    free, plain = _program(law(sinker(), "pid"), start), _program(law(sinker(), "pid"), start)
    plain.__dict__["identities"] = free.identities[:0]
    found, without = free.solve(), plain.solve()
    assert found is not None
    assert without is not None
    assert found.start < 0.51
    assert without.start > 1


def test_thrusters_that_push_and_turn_either_way_both_have_room_left() -> None:
    """With coupled axes V changes when surge alone turns round: each of a pair has its own bound."""
    limited = HEAVE.replace("LIMIT", "").replace("0.16]", "0.16]\nlimit = 0.2")
    coupled = loaded(limited + "[effects.added_mass_coupling]\nY_rdot = -0.3\n")
    program = _program(law(coupled, "pid"), dict.fromkeys(("x", "y", "z", "psi"), 0.2))
    found = program.solve()
    assert found is not None
    assert found.start > 2 * SETTINGS.lowest_start_level
    assert list(program.command_changes(found)) == pytest.approx([0.2 * (1 - SETTINGS.slack)] * 2, rel=2e-3)


def test_v_falls_for_the_error_that_is_set_point_less_pose_as_the_documents_say() -> None:
    """M u_dot = K_P e + K_I z - (K_V + d) u of surge alone; with the pose less the set-point V would rise."""
    table = {"schema": "undertow/gains/1", "name": "hull", "law": "pid"}
    table |= {"gains": {"K_P": {"x": 20.0}, "K_V": {"x": 80.0}, "K_I": {"x": 1.0}}}
    gains = gains_from_table(GainTable.model_validate(table), load_vehicle("box-hull"))
    found = region(Problem(gains), True).quadratic
    assert found is not None
    values = {name: load_vehicle("box-hull").value_of(name).value for name in ("m", "X_udot", "X_u")}
    M, K = values["m"] - values["X_udot"], 80.0 - values["X_u"]
    A = np.array([[0, 1, 0], [0, 0, -1], [1.0 / M, 20.0 / M, -K / M]])  # of (integral, error, u), near rest
    rate = found.P[0] @ A + A.T @ found.P[0]
    assert np.linalg.eigvalsh(rate).max() < 0
    turned = np.diag([-1, -1, 1]) @ found.P[0] @ np.diag([-1, -1, 1])
    assert np.linalg.eigvalsh(turned @ A + A.T @ turned).max() > 0
