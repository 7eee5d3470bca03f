"""Bounds in time hold against the model at every motion that they are for, and say no more than they know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sm
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm

from benchmarks.attacks import Attack, BoxTarget
from tests.control.test_certificates import loaded
from undertow.control.closed_loop import ClosedLoop, Scenario
from undertow.control.conditions import transient
from undertow.control.conditions.attitude import enclose
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.motion import DrivenMotion, PoseLoop, StartBox
from undertow.control.conditions.problem import Problem, Span
from undertow.control.conditions.responses import SETTINGS as KERNELS
from undertow.control.conditions.responses import Responses, modes, time_grid
from undertow.control.conditions.result import Transient
from undertow.control.conditions.transient import (
    PushBounds,
    Sector,
    SignalBounds,
    TubeSearch,
    bounds_in_time,
)
from undertow.control.gains import GainSet, GainTable, ScheduleTable, gains_from_table, load_gains
from undertow.control.laws import LawSignals
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle

FINE = KERNELS.ratios[-1]
NAMES = ("x", "y", "z", "phi", "theta", "psi")
MIRROR = (1, -1, 1, -1, 1, -1)  # port for starboard
BODY = """
schema = "undertow/vehicle/1"
name = "six"
degrees_of_freedom = ["surge", "sway", "heave", "roll", "pitch", "yaw"]
signs = "sname"
[effects.rigid_body]
m = 20.0
I_x = 0.5
I_y = 0.9
I_z = 0.8
[effects.rigid_body_coriolis]
[effects.added_mass]
X_udot = { forward = -8.0, backward = -9.0 }
Y_vdot = -14.0
Z_wdot = -15.0
K_pdot = -0.2
M_qdot = -0.4
N_rdot = -0.3
[effects.added_mass_coriolis]
[effects.linear_damping]
X_u = { forward = -8.0, backward = -9.0 }
Y_v = -12.0
Z_w = -12.0
K_p = -0.6
M_q = -0.9
N_r = -0.7
[effects.quadratic_damping]
X_uabsu = -10.0
Y_vabsv = { forward = -20.0, backward = -15.0 }
N_rabsr = -0.5
[effects.restoring]
W = 196.2
B = 197.0
z_b = -0.01
"""
START = {"x": 0.05, "y": 0.05, "z": 0.05, "phi": 0.06, "theta": 0.06, "psi": 0.06}


def _single(limit: float) -> str:
    """A thruster for each axis."""
    return "".join(
        f'[[thrusters]]\nname = "f{i}"\nwrench = {[float(i == k) for k in range(6)]}\nlimit = {limit}\n'
        for i in range(6)
    )


def loop(limit: float = 40.0, **changed: dict[str, float]) -> GainSet:
    """A loop whose gains tell x, y and z apart."""
    gains = {
        "K_P": dict(zip(NAMES, (10.0, 14.0, 12.0, 1.0, 1.4, 1.2), strict=True)),
        "K_V": dict(zip(NAMES, (20.0, 25.0, 22.0, 0.8, 1.2, 1.0), strict=True)),
        "K_I": dict(zip(NAMES, (0.4, 0.6, 0.5, 0.05, 0.06, 0.05), strict=True)),
    } | changed
    table = {"schema": "undertow/gains/1", "name": "six-pid", "law": "pid", "gains": gains}
    return gains_from_table(GainTable.model_validate(table), loaded(BODY + _single(limit)))


# --- the linear loop --------------------------------------------------------------------------------
def _stable(rng: np.random.Generator) -> np.ndarray:
    """A loop with slow and fast, damped and undamped modes."""
    block = np.zeros((5, 5))
    block[:2, :2] = [[-0.1, 3.0], [-3.0, -0.1]]
    block[2:, 2:] = np.diag([-0.02, -0.5, -4.0])
    turn = rng.normal(size=(5, 5))
    return turn @ block @ np.linalg.inv(turn)


def test_responses_are_bounded_between_the_ends_of_pieces_and_after_the_last() -> None:
    rng = np.random.default_rng(3)
    A, rows = _stable(rng), rng.normal(size=(4, 5))
    found = modes(enclose(A))
    times = time_grid(found.rates, FINE)
    bounds = Responses(found, rows, times).pieces(np.arange(4), np.full(4, 2))
    assert found.residual.max() < 1e-9
    for t in rng.uniform(0, 1, 300) ** 4 * 1.2 * times[-1]:
        piece = np.searchsorted(times, t, "right") - 1
        assert (np.abs(rows @ expm(A * t)[:, 2]) <= bounds[:, piece]).all()
    early = times[:40]
    at = np.array([np.abs(rows @ expm(A * t)[:, 2]) for t in early])
    assert at.max() > 0.95 * bounds[:, :39].max()  # and they are no looser than that


def test_integrals_of_responses_are_no_less_than_quadrature_says() -> None:
    rng = np.random.default_rng(4)
    A, row = _stable(rng), rng.normal(size=5)
    found = modes(enclose(A))
    kernels = Responses(found, row[None], time_grid(found.rates, FINE, 8)).kernels(
        np.array([0]), np.array([1])
    )
    for until in (0.3, 2.0, 30.0):
        exact = quad(lambda t: abs(row @ expm(A * t)[:, 1]), 0, until, limit=400)[0]
        ((least,),) = kernels.up_to(np.array([until]))
        assert exact <= least < 1.05 * exact
    assert kernels.weighted[0] > kernels.integral[-1, 0]


def test_an_unstable_loop_has_no_modes_to_bound_by() -> None:
    with pytest.raises(UndertowError, match="not stable"):
        modes(enclose(np.diag([-1.0, 0.1])))


def _closest(found: DrivenMotion, sector: Sector, runs: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """How near motions (states by time) come to their bounds, which they have to keep, by signal."""
    assert found.defect.max() < 1e-6
    assert found.initial_defect.max() < 1e-10
    closest = np.zeros(len(sector.rows))
    for times, motion in runs:
        seen, bounds = np.abs(sector.rows @ motion), found.signals[: len(times)].T
        assert (seen <= bounds * (1 + 1e-6) + 1e-9).all()
        closest = np.maximum(closest, seen.max(axis=1) / np.maximum(bounds.max(axis=1), 1e-12))
    return closest


def _integrated(
    sector: Sector, push: Callable[[np.ndarray], np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """z' = A z + push(z_1) from z = 0 for corners of the box, at the ends of pieces of time."""
    rng, size = np.random.default_rng(5), len(sector.A)
    times = time_grid(sector.modes.rates, FINE)
    times = times[times < 30]

    def rate(_: float, z: np.ndarray) -> np.ndarray:
        return np.concatenate([sector.A @ z[:size], sector.A @ z[size:] + push(z[:size])])

    found = []
    for _ in range(6):
        z = np.zeros(2 * size)
        z[sector.signals.error] = rng.choice((-1.0, 1.0), 6) * sector.starts.box
        run = solve_ivp(rate, (0, times[-1]), z, t_eval=times, rtol=1e-8, atol=1e-12)
        found.append((times, run.y[size:]))
    return found


def test_second_order_is_that_of_an_integration() -> None:
    """z_2' = A z_2 + q(z_1, z_1) from z_2 = 0: below the bound at all times, and once close to it."""
    sector = _sector()
    left, motion = sector.slopes, sector.motion

    def push(one: np.ndarray) -> np.ndarray:
        v, angles = one[-6:], -one[sector.signals.error][motion.angle_indices]
        pulled = np.tensordot(angles, left.W, 1) @ (sector.force @ one) - np.tensordot(angles, left.P, 1) @ v
        return np.append(np.zeros(12), pulled + left.Gamma @ v @ v)

    (found,) = sector.driven(time_grid(sector.modes.rates, FINE))
    assert _closest(found, sector, _integrated(sector, push))[sector.signals.rate].max() > 0.3


def test_motion_by_the_heading_is_that_of_an_integration_and_the_difference_of_two_headings() -> None:
    sector = _sector(0.7, 0.01)
    (_, found) = sector.driven(time_grid(sector.modes.rates, FINE))
    runs = _integrated(sector, lambda one: 0.01 * sector.heading_slope @ one)
    assert _closest(found, sector, runs)[sector.signals.rate].max() > 0.3
    other = _sector(0.7 + 1e-5)
    assert (
        np.abs((other.A - sector.A) / 1e-5 - sector.heading_slope).max()
        < 1e-4 * np.abs(sector.heading_slope).max()
    )


# --- what is left over ------------------------------------------------------------------------------
def _sector(heading: float = 0.7, half: float = 0.0) -> Sector:
    motion, start = PoseLoop(Problem(loop())), np.array([START[c] for c in NAMES])
    return Sector(motion, StartBox(start, motion.plane), TubeSearch(motion, start).slopes, heading, half)


@pytest.mark.parametrize(
    ("heading", "half", "mirror"),
    [(0.0, 0.0, (1,) * 6), (0.7, 0.1, (1,) * 6), (0.7, 0.1, MIRROR)],
    ids=["a heading", "a range", "the opposite range"],
)
def test_what_the_linear_loop_leaves_out_is_below_its_bound(
    heading: float, half: float, mirror: tuple[int, ...]
) -> None:
    """The acceleration of the model itself at random states, in every direction of motion.

    At the opposite headings the same bounds are those of the motion seen in a mirror.
    """
    rng, seen = np.random.default_rng(6), np.array(mirror)
    sector = _sector(heading, half)
    bounds, at = PushBounds([sector], TubeSearch(sector.motion, sector.starts.box).caps), sector.signals
    acceleration_of = _acceleration_of(sector.motion.problem.gains)
    closest = 0.0
    for k in range(60):
        size = 10 ** rng.uniform(-2, 0)
        error = rng.uniform(-1, 1, 6) * np.array([0.2, 0.2, 0.2, 0.2, 0.2, 0.2]) * size
        z = np.concatenate([rng.uniform(-0.3, 0.3, 6) * size, error, rng.uniform(-0.3, 0.3, 6) * size])
        place = seen[-1] * (heading + half * rng.choice((-1.0, 1.0)))
        own = np.tile(seen, 3) * z
        signals = np.abs(sector.rows @ own)[None]
        (push,) = bounds.push(SignalBounds(0 * signals, signals, np.zeros((1, 18))))
        acceleration = seen * acceleration_of(z, place)
        off = np.abs(acceleration - sector.rows[at.acceleration] @ own)
        assert (off <= push[at.rate] + 1e-12).all(), k
        closest = max(closest, float((off / push[at.rate]).max()))
    assert closest > 0.3


def _changed(text: str, thrusters: str = "") -> PoseLoop:
    gains = loop()
    own = loaded(BODY.replace(*text.split("->")) + (thrusters or _single(40.0)))
    table = {n: {c: gains.values[f"{n}_{c}"] for c in NAMES} for n in ("K_P", "K_V", "K_I")}
    raw = {"schema": "undertow/gains/1", "name": "six-pid", "law": "pid", "gains": table}
    return PoseLoop(Problem(gains_from_table(GainTable.model_validate(raw), own)))


@pytest.mark.parametrize(
    ("text", "mirrors"),
    [
        ("I_x = 0.5->I_x = 0.5\nx_g = 0.02\nz_g = 0.01", True),
        ("[effects.quad->[effects.linear_damping_coupling]\nN_v = -0.4\nM_w = 0.2\n[effects.quad", True),
        ("N_r = -0.7->N_r = { forward = -0.7, backward = -0.5 }", True),  # bounded by magnitudes
        ("I_x = 0.5->I_x = 0.5\ny_g = 0.02", False),
        ("[effects.quad->[effects.linear_damping_coupling]\nN_u = -0.4\n[effects.quad", False),
    ],
)
def test_only_a_vehicle_whose_port_is_as_its_starboard_is_its_mirror_image(text: str, mirrors: bool) -> None:
    assert _changed(text).mirror_symmetric == mirrors


def test_commands_at_the_opposite_heading_are_below_the_bounds_of_the_mirror_image() -> None:
    """One thruster pushes ahead beside the centre line: in a mirror it would be on the other side."""
    one = _single(40.0).replace("wrench = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]", "wrench = [1.0, 0, 0, 0, 0, -0.4]")
    motion, rng, seen = _changed("N_r = -0.7->N_r = -0.7", one), np.random.default_rng(8), np.array(MIRROR)
    start = np.array([START[c] for c in NAMES])
    sector = Sector(motion, StartBox(start, motion.plane), TubeSearch(motion, start).slopes, 0.7, 0.0)
    bounds = PushBounds([sector], TubeSearch(motion, start).caps)
    assert motion.mirror_symmetric
    assert motion.command_rows[0].shape == (2, 6, 6)
    force = motion.law_matrices(-0.7)[0]
    closest, one_sided = 0.0, 0.0
    for z in 1e-4 * rng.normal(size=(200, 18)):
        (most,) = bounds.commands(np.abs(sector.rows @ (np.tile(seen, 3) * z))[None])
        asked = np.abs(motion.commands.B_inverse @ force @ z + motion.restoring_rows @ z[6:12])
        assert (asked <= most - motion.commands.steady() + 1e-12).all()
        closest = max(closest, float((asked / (most - motion.commands.steady())).max()))
        alone = np.abs(motion.commands.B_inverse @ motion.law_matrices(0.7)[0] @ (np.tile(seen, 3) * z))
        one_sided = max(one_sided, float((asked / alone).max()))
    assert closest > 0.99
    assert one_sided > 2  # the bounds of one side alone would be too small


def test_sums_of_signals_are_bounded_by_what_they_are_made_of() -> None:
    sector, rng = _sector(0.7, 0.1), np.random.default_rng(7)
    for z in rng.normal(size=(20, 18)):
        whole = np.abs(sector.rows @ z)
        assert (whole[len(sector.base) :] <= sector.sums @ whole[: len(sector.base)] + 1e-12).all()


def _acceleration_of(gains: GainSet) -> Callable[[np.ndarray, float], np.ndarray]:
    """Of the pose, from the law and the model, in the frame of a set-point of a heading."""
    plant, s = gains.plant, LawSignals(gains.plant, gains.law)
    net = gains.law.force(s) - (plant.C + plant.D) * plant.nu - plant.g
    numbers = {**plant.numbers, **gains.numbers}
    matrices = [m.xreplace(numbers) for m in (plant.J, plant.J_dot, plant.M, net)]
    of = sm.lambdify([*plant.eta, *plant.nu, *s.error, *s.states], matrices, "numpy", cse=True)

    def acceleration(z: np.ndarray, heading: float) -> np.ndarray:
        turn = np.eye(6)
        turn[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
        integral, error, rate = turn @ z[:6], turn @ z[6:12], turn @ z[12:]
        pose = -error + np.array([0, 0, 0, 0, 0, heading])
        rest = [*np.zeros(6), *error, *integral]
        J = of(*pose, *rest)[0]
        nu = np.linalg.solve(J, rate)
        _, J_dot, M, force = of(*pose, *nu, *error, *integral)
        return turn.T @ (J @ np.linalg.solve(M, force) + J_dot @ nu[:, None])[:, 0]

    return acceleration


# --- the whole --------------------------------------------------------------------------------------
@pytest.mark.slow
def test_motions_from_every_corner_stay_within_their_bounds_at_all_times() -> None:
    gains = loop()
    found = bounds_in_time(Problem(gains), START)
    assert found is not None
    assert found.errors[-1].max() < 1e-3
    corners = np.array(list(product((-1.0, 1.0), repeat=6))) * list(START.values())
    for heading in (0.0, 0.9, 2.5):
        place = np.array([0, 0, 0, 0, 0, heading])
        first = dict(zip(NAMES, (place - corners).T, strict=True))
        runs = ClosedLoop(gains).run_many(Scenario(tuple(place), 30.0, 0.01), starts=first)
        piece = np.searchsorted(found.times, runs.t, "right") - 1
        seen = np.concatenate([np.abs(place - runs.states[..., :6]), np.abs(runs.states[..., 6:12])], axis=-1)
        most = np.concatenate([found.errors, found.speeds], axis=1)[piece]
        assert (seen <= most + 1e-3 * most.max(axis=0)).all()
        for i in range(6):
            asked = np.abs(runs.command(f"f{i}"))
            assert (asked <= found.commands[piece, i] * (1 + 1e-6)).all()
    assert found.errors.max(axis=0)[3:].max() < 2 * 0.06


@pytest.mark.slow
def test_a_loop_with_bounds_in_time_is_certified_and_false_bounds_are_broken() -> None:
    gains = loop()
    report = certify(gains, forms=["derived"], start=START)
    region = report.region
    assert report.ok
    assert region.kind == "box"
    assert region.contains_start
    assert region.starts == START
    found = region.transient
    assert found is not None

    def worst(share: float) -> float:
        less = replace(found, speeds=share * found.speeds)
        wrong = replace(report, region=replace(region, transient=less))
        how = Attack(generations=2, many=8)
        return BoxTarget(gains, wrong, 30.0, False, how).worst(np.random.default_rng(5))

    assert worst(1.0) < 1
    assert worst(0.3) > 1


def test_fast_couplings_and_thrusters_that_do_not_suffice_are_refused() -> None:
    """A weak spring in roll beside moments of moving through the water; 0.6 N where the start asks 0.7 N."""
    weak = dict(zip(NAMES, (10.0, 14.0, 12.0, 0.002, 1.4, 1.2), strict=True))
    slow = dict(zip(NAMES, (0.4, 0.6, 0.5, 1e-6, 0.06, 0.05), strict=True))
    far = dict.fromkeys(NAMES, 0.4)
    assert bounds_in_time(Problem(loop(K_P=weak, K_I=slow)), far) is None
    with pytest.raises(UndertowError, match=r"the start asks .* whose limit is 0\.6"):
        bounds_in_time(Problem(loop(limit=0.6)), {"y": 0.05})


def test_errors_are_halved_from_when_no_bound_rises_again() -> None:
    errors = np.array([[1.0, 0.1], [0.4, 0.04], [0.6, 0.01], [0.3, 0.05], [0.2, 0.04]])
    found = Transient(np.arange(5.0), errors, errors, errors, 0.1)
    assert found.halving_time == 3.0
    assert replace(found, errors=errors[:3], times=found.times[:3]).halving_time == np.inf


PITCHING = """
schema = "undertow/vehicle/1"
name = "two"
degrees_of_freedom = ["heave", "pitch"]
signs = "sname"
[effects.rigid_body]
m = 20.0
I_y = 0.9
[effects.linear_damping]
Z_w = -4.0
M_q = -0.9
[[thrusters]]
name = "lift"
wrench = [0, 0, 1, 0, 0, 0]
[[thrusters]]
name = "turn"
wrench = [0, 0, 0, 0, 1, 0]
"""


def test_translations_that_do_not_turn_as_a_rotation_get_no_bounds() -> None:
    """Without surge, pitch takes cos(theta)^2 off what heave gives: errors were 8 times their bounds."""
    gains = {
        "K_P": {"z": 20.0, "theta": 0.02},
        "K_V": {"z": 10.0, "theta": 0.4},
        "K_I": {"z": 1.0, "theta": 1e-4},
    }
    table = {"schema": "undertow/gains/1", "name": "two-pid", "law": "pid", "gains": gains}
    two = gains_from_table(GainTable.model_validate(table), loaded(PITCHING))
    with pytest.raises(UndertowError, match="do not turn as a rotation"):
        bounds_in_time(Problem(two), {"z": 0.05, "theta": 0.6})


def test_what_coarse_pieces_of_time_do_not_prove_finer_ones_may() -> None:
    """A start that is only just proved: no certificate is given up for the time that coarse pieces save."""
    motion, (coarse, middle, *_) = PoseLoop(Problem(loop())), KERNELS.ratios
    search, where = TubeSearch(motion, 3.95 * np.array([*START.values()])), [(0.0, 0.0)]
    assert search.unbounded(where, [], coarse) == where
    found: list[Transient] = []
    assert search.unbounded(where, found, middle) == []
    assert len(found) == 1
    begun = np.abs(found[0].errors[0])
    assert np.all(begun >= search.starts.box)


class _Prescribed(TubeSearch):
    """A search that is told up to which half width ranges have bounds, and in how fine pieces of time."""

    def __init__(self, half: Callable[[float], float], ratio: float) -> None:
        self.half, self.ratio, self.motion = half, ratio, SimpleNamespace(mirror_symmetric=False)
        self.looked: list[tuple[int, float]] = []  # how many ranges at a time, in which pieces of time
        self.proved: list[Span] = []

    def unbounded(self, ranges: Sequence[Span], found: list, ratio: float) -> list[Span]:
        self.looked.append((len(ranges), ratio))
        there = [h <= self.half(m) and ratio <= self.ratio for m, h in ranges]
        found += [there] * sum(there)
        self.proved += [span for span, holds in zip(ranges, there, strict=True) if holds]
        return [span for span, holds in zip(ranges, there, strict=True) if not holds]


def test_a_search_is_given_up_where_a_narrowest_range_has_no_bounds() -> None:
    coarse, middle, fine = KERNELS.ratios
    hopeless = _Prescribed(lambda _: 0.0, fine)
    assert hopeless.cover([(0.1, 0.1), (0.3, 0.1), (0.5, 0.1)], 3) is None
    assert hopeless.looked == [(3, coarse), (3, coarse), (3, middle), (3, fine)]


@pytest.mark.parametrize("first", [True, False])
def test_a_range_without_bounds_ends_a_search_in_which_others_are_still_gone_through(*, first: bool) -> None:
    """It is in the finest pieces of time when the other one is in the coarsest, in either order."""
    told = _Prescribed(lambda middle: 0.026 * ((middle < 0.2) is not first), KERNELS.ratios[0])
    assert told.cover([(0.1, 0.1), (0.3, 0.1)], 3) is None
    assert told.proved


@pytest.mark.parametrize("widest", [1.0, 0.5, 0.25, 0.125], ids=lambda w: f"{w:g} of a range")
def test_ranges_are_cut_as_narrow_as_they_need_and_every_heading_is_in_one(
    monkeypatch: pytest.MonkeyPatch, widest: float
) -> None:
    """Below 0.4 rad whole ranges have bounds, above it parts of them, which are found without detours."""
    monkeypatch.setattr(transient, "_merged", len)
    told = _Prescribed(lambda middle: 0.1001 * (1.0 if middle < 0.4 else widest), KERNELS.ratios[-1])
    told.ratio = KERNELS.ratios[0]
    assert told.cover([(0.1, 0.1), (0.3, 0.1), (0.5, 0.1)], 3) == len(told.proved)
    ends = sorted((m - h, m + h) for m, h in told.proved)
    assert ends[0][0] == pytest.approx(0.0)
    assert ends[-1][1] == pytest.approx(0.6)
    assert [a for a, _ in ends[1:]] == pytest.approx([b for _, b in ends[:-1]])
    assert max(h for m, h in told.proved if m > 0.4) == pytest.approx(0.1 * widest)
    # One range is looked at too wide, and half a part where parts grow from the narrowest.
    assert sum(count for count, _ in told.looked) <= 3 + 8 + 2


def test_pieces_of_time_too_coarse_for_single_headings_are_tried_of_no_range(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    coarse, middle, fine = KERNELS.ratios
    told = _Prescribed(lambda _: np.pi, fine)
    for name, of in {"TubeSearch": lambda *_: told, "PoseLoop": lambda *_: None, "_merged": len}.items():
        monkeypatch.setattr(transient, name, of)
    monkeypatch.setattr(Problem, "heading_matters", True)
    gains = load_gains("paper-pd", load_vehicle("mini-auv"))
    problem = Problem(replace(gains, schedule=ScheduleTable()))
    assert bounds_in_time(problem, {"x": 0.1}) == 16
    assert told.looked == [(8, coarse), (8, middle), (8, fine), (16, fine)]
    told.motion.mirror_symmetric = True
    assert bounds_in_time(problem, {"x": 0.1}) == 8
