"""What remains is described by what the simulator put in, and by nothing where chance is all there is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.hidden_effects import Case, make_case
from benchmarks.hidden_effects.registry import ALL, EFFECTS, Draw, HiddenEffect
from benchmarks.hidden_effects.world import World
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from tests.identification.surge import surge_run, surge_vehicle
from undertow.identification.diagnosis.associations import (
    SETTINGS,
    STEP,
    Association,
    Difference,
    Sample,
    Samples,
    Series,
    Term,
    Trajectory,
    coefficient_unit,
    difference,
    highest_peak,
    step_terms,
    terms_of,
    without_waves,
)
from undertow.identification.diagnosis.force_rows import ForceRows, sliding_sums
from undertow.identification.diagnosis.residual import effect_on_motion, remaining, sentence, unrelated_to
from undertow.identification.diagnosis.result import BetweenRuns, Dependence, Remaining, Spectrum
from undertow.identification.diagnosis.splitting import split_into_pieces
from undertow.identification.estimation.data import WeakData
from undertow.identification.estimation.weak_form import WeakFit, fit_weak
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

HEADING, COMMANDS = ("turning_drag", "heading_force"), ("thruster_interference", "periodic_side_force")


@cache
def _simulated(effects: tuple[str, ...], seed: int, of: str = "usv") -> Case:
    """A vehicle with something that its model lacks, in four runs of 60 s."""
    return make_case(of, effects, seed, duration=60.0)


@cache
def _fitted(
    effects: tuple[str, ...], seed: int, of: str = "usv"
) -> tuple[dict[str, dict[str, float]], WeakFit, WeakData]:
    """What was drawn, the model refitted to three of the runs, and the fourth."""
    case = _simulated(effects, seed, of)
    runs = runs_of(case)
    return case.truth["values"], *_refitted(vehicle_of(case), runs[:3], runs[3:])


def _refitted(vehicle: Vehicle, runs: list[Run], aside: list[Run]) -> tuple[WeakFit, WeakData]:
    data, kept = prepared(vehicle, runs, aside)
    return fit_weak(vehicle, data), kept


@cache
def _left(
    *effects: str, seed: int = 1, of: str = "usv"
) -> tuple[dict[str, dict[str, float]], dict[str, Remaining]]:
    values, fit, aside = _fitted(effects, seed, of)
    return values, {r.degree_of_freedom: r for r in remaining(fit, fit.data, aside)}


def _is_silent(left: Remaining) -> bool:
    return not (left.depends_on or left.spectrum or left.trend or left.between_runs)


# --- simulated vehicles -----------------------------------------------------------------------------
@pytest.mark.slow
def test_drag_in_turns_goes_with_the_yaw_rate_and_the_speed() -> None:
    values, left = _left(*HEADING)
    reported, k = left["surge"].depends_on[0], values["turning_drag"]["k"]
    assert reported.term == "|r| u"
    assert reported.coefficients[0] == pytest.approx(-k, abs=4 * reported.standard_errors[0])
    assert reported.standard_errors[0] < 0.2 * k
    assert reported.units == ["N/((rad/s) (m/s))"]
    assert reported.share > 0.9
    assert "correlates with |r| u (slows surge, the more the faster it turns)" in left["surge"].summary


def test_what_remains_does_not_depend_on_where_a_fit_ended() -> None:
    """Of the same logs, damping and added mass that are far off hide no term."""
    _, fit, aside = _fitted(HEADING, 1)
    p = np.array(fit.p)
    p[list(fit.model.places)] *= 1.5
    (found, off) = (remaining(f, fit.data, aside)[0].depends_on[0] for f in (fit, fit.with_parameters(p)))
    assert off.term == found.term
    assert off.share == pytest.approx(found.share, abs=0.05)
    assert off.chance == found.chance


def test_a_force_that_turns_with_the_heading() -> None:
    values, left = _left(*HEADING)
    (reported,) = left["sway"].depends_on
    assert reported.term == "sin and cos of 2 psi"
    assert np.hypot(*reported.coefficients) == pytest.approx(values["heading_force"]["A"], rel=0.1)
    angle = np.arctan2(-reported.coefficients[1], reported.coefficients[0])
    assert np.sin(angle - 2 * values["heading_force"]["psi_0"]) == pytest.approx(0.0, abs=0.1)
    assert left["sway"].spectrum is None


@pytest.mark.parametrize("effects", [HEADING, pytest.param(COMMANDS, marks=pytest.mark.slow)])
def test_what_is_right_stays_right_although_all_accelerations_are_coupled(effects: tuple[str, ...]) -> None:
    _, left = _left(*effects)
    assert _is_silent(left["yaw"])
    assert left["yaw"].normalised_error < 1.15


def test_thrust_that_falls_with_speed_goes_with_all_commands_together() -> None:
    """One thruster alone explains half; where only one pushes ahead, it is that one."""
    values, left = _left("falling_thrust", of="catamaran")
    (reported,) = left["surge"].depends_on
    assert reported.term == "u times each command"
    assert reported.columns == [["command f1", "u"], ["command f2", "u"]]
    assert reported.coefficients == pytest.approx([-values["falling_thrust"]["k"]] * 2, rel=0.15)
    assert "N/(command (m/s))" in left["surge"].summary
    single = _left("falling_thrust", of="ship", seed=2)[1]["surge"].depends_on[0]
    assert single.columns == [["command f1", "u"]]


@pytest.mark.slow
def test_a_force_that_follows_two_commands() -> None:
    _, left = _left(*COMMANDS)
    reported = left["surge"].depends_on[0]
    assert reported.columns == [["|command f1|", "|command f2|"]]
    assert reported.units == ["N/command^2"]
    assert reported.coefficients[0] < 0
    assert reported.share > 0.9


def test_a_periodic_force_shows_its_period() -> None:
    values, left = _left(*COMMANDS)
    found = left["sway"].spectrum
    assert found is not None
    assert found.period == pytest.approx(values["periodic_side_force"]["P"], rel=0.03)
    assert found.amplitude == pytest.approx(values["periodic_side_force"]["A"], rel=0.15)
    assert found.in_step
    assert found.share > 0.8
    assert left["sway"].depends_on == []
    assert f"period {found.period:.3g} s stands out" in left["sway"].summary


@pytest.mark.slow
def test_a_drag_that_grows_is_a_trend() -> None:
    values, left = _left("growing_drag")
    trend = left["yaw"].trend
    assert trend is not None
    assert trend.of == "r"
    assert trend.unit == "N m/(rad/s)"
    _, fit, _ = _fitted(("growing_drag",), 1)
    # The drag of the fit is that of the middle of a run, half a minute after its start.
    rate = values["growing_drag"]["rate"]
    assert trend.change == pytest.approx(100.0 * rate * fit.values["N_r"] / (1 + 30.0 * rate), rel=0.3)
    assert "the more the longer the run lasts" in left["yaw"].summary


@pytest.mark.slow
def test_a_weight_that_is_dropped_is_a_step() -> None:
    values, left = _left("dropped_weight", seed=2, of="float")
    reported, true = left["heave"].depends_on[0], values["dropped_weight"]
    step = STEP.fullmatch(reported.columns[0][0])
    assert step is not None
    assert float(step[1]) == pytest.approx(true["t_0"], abs=2 * 60.0 / SETTINGS.step_times)
    # Lighter by dW is a force of -dW in heave, which is positive down; steps are tried every 2.4 s only.
    assert reported.coefficients[0] == pytest.approx(-true["dW"], rel=0.2)
    assert reported.units == ["N"]
    assert f"a step at {step[1]} s (" in left["heave"].summary
    assert left["heave"].summary.count("N from then on") == 1


@pytest.mark.slow
def test_a_drag_that_comes_suddenly_is_told_from_one_that_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of the hidden effects grows; here is one more, twice as large from 35 s on."""

    def apply(world: World, draw: Draw) -> dict[str, float]:
        world.wrenches.append(lambda now: now.drag * (now.t >= 35.0))
        return {}

    monkeypatch.setitem(EFFECTS, "late_drag", HiddenEffect("late_drag", None, "alien", ALL, apply))
    _, grown = _left("growing_drag")
    assert STEP.fullmatch(grown["yaw"].depends_on[0].columns[0][0]) is None
    _, left = _left("late_drag")
    column = left["surge"].depends_on[0].columns[0]
    step = STEP.fullmatch(column[0])
    assert step is not None
    assert float(step[1]) == pytest.approx(35.0, abs=2 * 60.0 / SETTINGS.step_times)
    assert f"{' '.join(column[1:])} from {step[1]} s on" in left["surge"].summary
    assert "(slows surge" in left["surge"].summary


def test_thrust_that_is_lost_suddenly_is_told_from_one_that_fades(monkeypatch: pytest.MonkeyPatch) -> None:
    """It goes with commands; with a speed that follows them it goes less."""

    def apply(world: World, draw: Draw) -> dict[str, float]:
        world.stages.append(lambda f, t: f * (0.6 if t >= 35.0 else 1.0))
        return {}

    monkeypatch.setitem(EFFECTS, "late_loss", HiddenEffect("late_loss", None, "alien", ALL, apply))
    _, fit, aside = _fitted(("late_loss",), 1, "usv")
    vehicle, left = fit.model.functions.vehicle, remaining(fit, fit.data, aside)
    dependence = left[1].depends_on[0]
    step = STEP.fullmatch(dependence.columns[0][0])
    assert step is not None
    assert float(step[1]) == pytest.approx(35.0, abs=2 * 60.0 / SETTINGS.step_times)
    assert any("command" in factor for factor in dependence.columns[0])
    # Thrust that fades knows the time and all commands, and no step.
    own = {"t", *vehicle.velocity_names, *vehicle.command_names}
    assert [r.depends_on for r in unrelated_to(own, left, vehicle)] == [[dependence]]


def test_a_complete_model_shows_nothing() -> None:
    _, left = _left()
    assert all(_is_silent(r) for r in left.values())
    assert all(r.summary.endswith("rms remains, which is noise") for r in left.values())
    assert all(0.8 < r.normalised_error < 1.15 for r in left.values())
    assert all(r.residual_rms == pytest.approx(r.noise_rms, rel=0.15) for r in left.values())


@pytest.mark.slow
def test_gusts_go_with_nothing() -> None:
    values, left = _left("gusts", seed=6)
    loud = [r for r in left.values() if r.normalised_error > 1.2]
    assert {r.degree_of_freedom for r in loud} == {"surge", "sway"}
    assert all(_is_silent(r) for r in loud)
    assert all("correlates significantly with none of the logged variables" in r.summary for r in loud)
    # The force comes from the north and turns about the ship: its two parts share its power.
    assert np.hypot(*(r.excess_rms for r in loud)) == pytest.approx(values["gusts"]["rms"], rel=0.4)


def test_a_row_is_a_force_and_its_columns_are_derivatives() -> None:
    _, fit, aside = _fitted(HEADING, 1)
    rows = ForceRows(fit, aside)
    (part,), (column,) = rows.row(0).parts, rows.columns([("u",)])
    drag = part.J[:, fit.model.free.index("X_u")]
    # The weak form reads the velocity a little after a jump of the commands, a description does not.
    assert np.max(np.abs(column[:, 0] - drag)) < 1e-3 * np.max(np.abs(drag))
    assert np.median(np.abs(column[:, 0] - drag)) < 1e-9


# --- the search for associations ----------------------------------------------------------------------
TERMS = (Term("first", (("u",),)), Term("pair", (("v",), ("r",))), Term("own", (("p",),)))


def _slow(rng: np.random.Generator, count: int, memory: int = 10) -> np.ndarray:
    """Noise that remembers `memory` entries."""
    kernel = np.ones(memory) / np.sqrt(memory)
    return np.convolve(rng.standard_normal(count + memory), kernel, "valid")[:count]


def _association(seed: int, mixture: tuple[float, ...], block: int = 60) -> Association:
    rng, count = np.random.default_rng(seed), 1200
    own = np.column_stack([_slow(rng, count), np.ones(count)])
    columns = np.column_stack([*(_slow(rng, count) for _ in range(3)), own[:, 0]])
    r = _slow(rng, count) - columns @ np.array([*mixture, 0.0])
    r -= own @ np.linalg.lstsq(own, r, rcond=None)[0]
    number = np.arange(count) // block
    fitted = Sample(r[:800], own[:800], columns[:800], number[:800])
    aside = Sample(r[800:], own[800:], columns[800:], number[800:] - number[800])
    return Association(TERMS, Samples(fitted, aside, aside), np.zeros((2, 2)))


def test_the_term_in_the_residual_is_found_with_its_coefficient() -> None:
    found = _association(1, (0.0, 0.8, -0.6)).strongest()
    assert found is not None
    assert found.term.label == "pair"
    assert found.coefficients == pytest.approx([0.8, -0.6], abs=0.25)
    assert found.chance < 0.002
    assert found.errors == pytest.approx([0.06, 0.06], rel=1.0)


def test_two_thrusters_with_one_command_share_their_coefficient() -> None:
    rng = np.random.default_rng(4)
    parts = []
    for _ in range(2):
        command = _slow(rng, 800)
        columns = np.column_stack([command, command])
        # Rounding alone tells the two apart, and must not.
        columns[:, 1] *= 1.0 + 1e-15 * rng.standard_normal(800)
        r = _slow(rng, 800) - 0.8 * command
        parts.append(Sample(r, np.zeros((800, 0)), columns, np.arange(800) // 60))
    both = Term("each command", (("port",), ("starboard",)))
    found = Association((both,), Samples(*parts, parts[1]), np.zeros((0, 0))).strongest()
    assert found is not None
    assert found.coefficients == pytest.approx([0.4, 0.4], abs=0.1)
    assert np.all(found.errors < 0.1)


def test_what_is_taken_out_does_not_come_back() -> None:
    start = _association(1, (0.5, 0.8, -0.6))
    first = start.strongest()
    assert first is not None
    rest = start.without(first)
    second = rest.strongest()
    assert second is not None
    assert {first.term.label, second.term.label} == {"first", "pair"}
    assert rest.samples.validation.square == pytest.approx(start.samples.validation.square - first.fall)
    assert rest.without(second).samples.validation.square < 1.2 * 400


def test_slow_noise_goes_with_nothing() -> None:
    chances = [(f.chance if (f := _association(seed, (0.0,) * 3).strongest()) else 1.0) for seed in range(60)]
    assert np.mean(np.array(chances) < 0.1) < 0.2
    assert min(chances) > 0.002


def test_what_the_model_could_take_over_is_no_news() -> None:
    rest, found = _association(1, (0.5, 0.0, 0.0)), []
    while (term := rest.strongest()) is not None and len(found) < len(TERMS):
        found.append(term.term.label)
        rest = rest.without(term)
    assert "own" not in found


# --- the search for a line -----------------------------------------------------------------------------
def _series(seed: int, amplitude: float, runs: int = 2, frequency: float = 0.21) -> Series:
    rng, t = np.random.default_rng(seed), np.arange(0.0, 60.0, 0.25)
    phases = rng.uniform(0, 2 * np.pi, runs)
    waves = [amplitude * np.sin(2 * np.pi * frequency * t + p) for p in phases]
    r = np.concatenate(waves) + rng.standard_normal(runs * len(t))
    return Series(np.tile(t, runs), r, np.repeat(np.arange(runs), len(t)))


def test_a_line_is_found_although_every_run_has_its_phase() -> None:
    peak = highest_peak(_series(1, 1.0), _series(2, 1.0, runs=1), 1.0)
    assert peak is not None
    assert 1 / peak.frequency == pytest.approx(1 / 0.21, rel=0.02)
    assert peak.chance < 1e-6
    assert peak.excess == pytest.approx(0.5 * 240, rel=0.3)


def test_noise_has_no_line() -> None:
    peaks = [highest_peak(_series(s, 0.0), _series(100 + s, 0.0, runs=1), 1.0) for s in range(20)]
    chances = [p.chance for p in peaks if p is not None]
    assert len(chances) == 20
    assert min(chances) > 1e-4
    assert np.mean(np.array(chances) < 0.1) < 0.25


def _slow_series(seed: int, seconds: float, runs: int) -> Series:
    """Autoregressive forces that forget themselves in some seconds, and white noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 100.0, 0.3)
    a = np.exp(-0.3 / seconds)
    drive = rng.standard_normal((runs, len(t) + 200)) * np.sqrt(1 - a**2)
    slow = lfilter([1.0], [1.0, -a], drive)[:, 200:]
    r = (slow + 0.1 * rng.standard_normal(slow.shape)).ravel()
    return Series(np.tile(t, runs), r, np.repeat(np.arange(runs), len(t)))


@pytest.mark.parametrize("seconds", [1.0, 10.0])
def test_slow_forces_have_no_line(seconds: float) -> None:
    """They have most power at the lowest frequencies, where there are few to compare with."""
    pairs = [(_slow_series(s, seconds, 3), _slow_series(1000 + s, seconds, 1)) for s in range(100)]
    peaks = [highest_peak(*pair, fastest=0.8) for pair in pairs]
    chances = np.array([p.chance for p in peaks if p is not None])
    assert len(chances) == 100
    assert min(chances) > 1e-4
    assert np.mean(chances < 0.05) <= 0.06


def test_four_periods_of_a_strong_line_are_found_among_slow_forces() -> None:
    def with_line(seed: int, runs: int) -> Series:
        slow = _slow_series(seed, 10.0, runs)
        return replace(slow, r=slow.r + 3.0 * np.sin(2 * np.pi * slow.t / 25.0 + seed + slow.run))

    peak = highest_peak(with_line(1, 3), with_line(2, 1), fastest=0.8)
    assert peak is not None
    assert 1 / peak.frequency == pytest.approx(25.0, rel=0.05)
    assert peak.chance < 1e-4


def test_a_line_of_one_run_only_is_not_confirmed() -> None:
    peak = highest_peak(_series(1, 1.0), _series(2, 0.0, runs=1), 1.0)
    assert peak is not None
    assert peak.chance > 0.01


def test_runs_that_are_too_short_for_a_period_have_no_line() -> None:
    short = Series(np.arange(0.0, 4.0, 0.25), np.zeros(16), np.zeros(16, dtype=np.intp))
    assert highest_peak(short, short, 1.0) is None


def test_waves_are_taken_out_run_by_run() -> None:
    s = _series(3, 2.0, frequency=0.25)
    angle = 2 * np.pi * 0.25 * s.t
    left, coefficients = without_waves(s.r, np.column_stack([np.cos(angle), np.sin(angle)]), s.run)
    assert np.linalg.norm(coefficients, axis=1) == pytest.approx([2.0, 2.0], abs=0.3)
    assert np.std(left) == pytest.approx(1.0, abs=0.1)


# --- the run ---------------------------------------------------------------------------------------------
def _compared(
    r: np.ndarray, columns: np.ndarray, run: np.ndarray, block: np.ndarray, own: np.ndarray | None = None
) -> Difference | None:
    """Runs compared beside parameters of the model of which nothing else is known."""
    own = np.zeros((len(r), 0)) if own is None else own
    sample = Sample(r, own, columns, block)
    return difference(sample, slice(0, columns.shape[1]), np.zeros((own.shape[1],) * 2), run)


def test_runs_that_differ_are_told_from_runs_that_do_not() -> None:
    rng, run = np.random.default_rng(5), np.repeat(np.arange(3), 200)
    r, block, one = rng.standard_normal(600), np.arange(600) // 20, np.ones((600, 1))
    alike = _compared(r, one, run, block)
    other = _compared(r - 0.6 * (run == 2), one, run, block)
    assert alike is not None
    assert alike.chance > 0.01
    assert other is not None
    assert other.chance < 1e-6
    assert other.values[:, 0] == pytest.approx([0.0, 0.0, 0.6], abs=0.25)
    assert _compared(r[:200], one[:200], run[:200], block[:200]) is None


def test_runs_that_are_too_short_are_not_compared() -> None:
    """A run of which a motion has hardly a sample says nothing; the others are compared without it."""
    rng, run = np.random.default_rng(5), np.repeat([0, 2, 3], [200, 30, 200])
    r, block = rng.standard_normal(430) - 0.6 * (run == 3), np.arange(430) // 20
    found = _compared(r, np.ones((430, 1)), run, block)
    assert found is not None
    assert found.runs.tolist() == [0, 3]
    assert found.values[:, 0] == pytest.approx([0.0, 0.6], abs=0.25)


def test_a_parameter_that_is_off_makes_no_difference_between_runs_at_speeds_of_their_own() -> None:
    """Drag of another size is another mean force at every speed; a force that differs beside it is found."""
    rng, run = np.random.default_rng(9), np.repeat(np.arange(4), 400)
    speed = np.array([0.2, 0.5, 1.0, 1.4])[run] + 0.1 * rng.standard_normal(1600)
    block, drag, one = np.arange(1600) // 20, (speed**2)[:, None], np.ones((1600, 1))
    r = rng.standard_normal(1600) - 0.4 * speed**2
    plain, beside = _compared(r, one, run, block), _compared(r, one, run, block, drag)
    assert plain is not None
    assert plain.chance < 1e-6
    assert beside is not None
    assert beside.chance > 0.01
    other = _compared(r - 0.8 * (run == 1), one, run, block, drag)
    assert other is not None
    assert other.chance < 1e-4


def test_what_a_run_leaves_open_is_no_value_of_it() -> None:
    """A run on one heading says what the force is along it, and nothing of the force across."""
    rng, run = np.random.default_rng(7), np.repeat(np.arange(4), 400)
    heading = np.where(run == 3, 0.4 + 1e-4 * rng.standard_normal(1600), rng.uniform(0, 2 * np.pi, 1600))
    columns = np.column_stack([np.sin(heading), np.cos(heading)])
    true = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.5], [0.5, 0.5]])
    r = 0.2 * rng.standard_normal(1600) - np.einsum("mk,mk->m", columns, true[run])
    found = _compared(r, columns, run, np.arange(1600) // 20)
    assert found is not None
    assert found.chance < 1e-6
    assert found.values[:3] == pytest.approx(true[:3], abs=0.1)
    along = np.array([np.sin(0.4), np.cos(0.4)])
    assert found.values[3] @ along == pytest.approx(true[3] @ along, abs=0.1)
    assert np.linalg.norm(found.values[3]) < 1.5


# --- terms and words -----------------------------------------------------------------------------------
def test_terms_are_made_of_what_the_vehicle_has() -> None:
    labels = {t.label for t in terms_of(load_vehicle("mini-auv"), ("z", "psi"))}
    assert {"a constant", "u", "|u| u", "u^2", "|r| u", "u v", "t u", "z", "f1", "f1 f2"} <= labels
    assert {"sin and cos of psi", "sin and cos of 2 psi", "z sin and cos of psi", "f2 u"} <= labels
    assert not labels & {"p", "q", "phi", "sin(phi)", "x"}
    assert "sin and cos of psi" not in {t.label for t in terms_of(load_vehicle("mini-auv"), ())}


@pytest.mark.parametrize("first", [0.0, -50.0, 1.7e9])
def test_steps_lie_evenly_within_the_logs(first: float) -> None:
    found = [STEP.fullmatch(t.columns[0][0]) for t in step_terms(first + np.arange(0.0, 100.0, 0.5))]
    times = np.array([float(m[1]) for m in found if m is not None])
    assert len(times) == len(found) >= SETTINGS.step_times - 1
    assert first < times[0]
    assert times[-1] < first + 100.0
    assert np.all(times != 0.0)
    assert np.diff(times).max() < 2.1 * 100.0 / SETTINGS.step_times


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ((), "N m"),
        (("u",), "N m/(m/s)"),
        (("|r|", "r"), "N m/(rad/s)^2"),
        (("t", "u"), "N m/(s (m/s))"),
        (("sin(2 psi)",), "N m"),
        (("z", "cos(psi)"), "N m/m"),
        (("command f1", "|r|"), "N m/(command (rad/s))"),
        (("command tau_N",), "N m/(N m)"),
        (("step(t - 35.5)",), "N m"),
    ],
)
def test_units_of_coefficients(column: tuple[str, ...], unit: str) -> None:
    assert coefficient_unit("N m", column) == unit


def test_columns_along_a_log() -> None:
    trajectory = Trajectory(
        {"u": np.array([1.0, -2.0]), "psi": np.array([0.0, np.pi / 4]), "t": np.array([0.0, 3.0])},
        {"f1": np.array([-2.0, 2.0]), "f2": np.array([5.0, 1.0])},
    )
    assert trajectory.motion_product(("|u|", "u")).tolist() == [1.0, -4.0]
    assert trajectory.motion_product(("sin(2 psi)", "t")) == pytest.approx([0.0, 3.0])
    assert trajectory.motion_product(()).tolist() == [1.0, 1.0]
    assert trajectory.motion_product(("step(t - 2.5)",)).tolist() == [0.0, 1.0]
    assert trajectory.command_product(("|command f1|", "u", "command f2")).tolist() == [10.0, 2.0]
    assert trajectory.command_product(("u",)) is None


def _reported(columns: list[list[str]], coefficients: list[float], term: str) -> Dependence:
    size = len(coefficients)
    return Dependence(
        term=term,
        columns=columns,
        coefficients=coefficients,
        standard_errors=[0.1] * size,
        units=["N"] * size,
        share=0.706,
        chance=0.001,
        alike=["|v| u", "u^2", "f1"],
    )


@pytest.mark.parametrize(
    ("columns", "coefficients", "words"),
    [
        ([["|r|", "u"]], [-2.0], "slows surge, the more the faster it turns"),
        ([["u"]], [2.0], "drives surge on"),
        ([["t", "|u|", "u"]], [-2.0], "slows surge, the more the longer the run lasts"),
        ([["u", "v"]], [2.0], "rises as term grows"),
        ([["u", "u"]], [-2.0], "falls as term grows"),
        ([[]], [0.25], "0.25 N"),
        ([["sin(psi)"], ["cos(psi)"]], [3.0, 4.0], "amplitude 5 N"),
        ([["command f1", "u"], ["|command f2|", "u"]], [3.0, -4.0], "3 for f1, -4 for f2; N"),
    ],
)
def test_what_a_term_does(columns: list[list[str]], coefficients: list[float], words: str) -> None:
    reported = _reported(columns, coefficients, "term")
    assert words in effect_on_motion(reported, "surge", "N")


def test_a_sentence_holds_all_that_was_found() -> None:
    left = Remaining(
        degree_of_freedom="surge",
        normalised_error=2.0,
        residual_rms=0.9,
        noise_rms=0.4,
        unit="N",
        note="",
        excess_rms=0.812,
        depends_on=[_reported([["|r|", "u"]], [-2.0], "|r| u")],
        spectrum=Spectrum(period=6.3, amplitude=0.2, share=0.1, chance=1e-6, in_step=False),
        between_runs=[BetweenRuns(of="mean force", values={"a": [-1.0], "b": [2.0]}, unit="N", chance=1e-7)],
    )
    assert sentence(left, above_noise=True) == (
        "surge: 0.81 N rms remains above the noise; 71% of it correlates with |r| u or |v| u or u^2 (slows "
        "surge, the more the faster it turns); period 6.3 s stands out (amplitude 0.2 N, 10% of it, with a "
        "different phase in every run); the mean force differs from run to run (-1 to 2 N)"
    )
    assert sentence(left, above_noise=False) == "surge: 0.9 N rms remains, which is noise"


# --- other logs --------------------------------------------------------------------------------------
def test_one_motion_driven_by_a_force_in_the_log() -> None:
    whole = surge_vehicle()
    less = {n: v for n, v in whole.values.items() if n != "X_uabsu"}
    kept = tuple(e for e in whole.effects if e.id != "quadratic_damping")
    vehicle = replace(whole, values=less, effects=kept)
    runs = [surge_run(0.001, seed=i) for i in range(3)]
    fit, aside = _refitted(vehicle, runs[:2], runs[2:])
    (left,) = remaining(fit, fit.data, aside)
    assert left.normalised_error > 3.0
    assert {"|u| u", "u^2"} & {left.depends_on[0].term, *left.depends_on[0].alike}


def _turning(fit: WeakFit, aside: WeakData) -> Dependence:
    left = {r.degree_of_freedom: r for r in remaining(fit, fit.data, aside)}
    assert _is_silent(left["yaw"])
    return left["sway"].depends_on[0]


@pytest.mark.slow
def test_velocities_from_pose() -> None:
    case = _simulated(HEADING, 1)
    vehicle, runs = vehicle_of(case), runs_of(case)
    kept = ("x", "y", "psi", *vehicle.command_names)
    poses = [replace(r, channels={n: r.channels[n] for n in kept}) for r in runs]
    derived = [velocities_from_pose(r, vehicle.degrees_of_freedom) for r in poses]
    assert _turning(*_refitted(vehicle, derived[:3], derived[3:])).term == "sin and cos of 2 psi"


def test_stretches_kept_aside() -> None:
    case = _simulated(HEADING, 1)
    assert (
        _turning(*_refitted(vehicle_of(case), *split_into_pieces(runs_of(case)))).term
        == "sin and cos of 2 psi"
    )


@pytest.mark.parametrize("count", [0, 1, 5])
def test_a_segment_shorter_than_the_average_has_none(count: int) -> None:
    assert sliding_sums(count, 6).shape == (0, count)
    assert sliding_sums(6, 6).toarray() == pytest.approx(np.ones((1, 6)))
