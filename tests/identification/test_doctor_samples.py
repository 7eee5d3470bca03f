"""The doctor on clock, samples and excitation, and the lines it writes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, vehicle_of
from undertow.errors import UndertowError
from undertow.identification.doctor.examine import examine, refuse_impossible
from undertow.identification.doctor.sampling import excitation, excitation_findings, sampling, was_filtered
from undertow.identification.findings import Finding
from undertow.identification.logs.mapping import (
    Edit,
    LogMapping,
    as_toml,
    column_edit,
    delay_edit,
    edited,
    frames_edits,
    into_file,
    mapping_text,
    reassigned,
)
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Value, Vehicle

RNG = np.random.default_rng(3)


def _run(t: np.ndarray, **channels: np.ndarray) -> Run:
    return Run("run", t, channels)


def _found(run: Run, mapping: LogMapping | None = None) -> dict[str, Finding]:
    found = sampling([run], list(run.channels), mapping or LogMapping())
    return {f.id: f for f in found}


# --- sampling --------------------------------------------------------------------------------------------
def test_an_even_clock_is_not_worth_a_word() -> None:
    t = np.arange(0.0, 20.0, 0.05)
    assert not _found(_run(t, u=np.sin(t) + 0.01 * RNG.standard_normal(len(t))))


def test_jitter_is_reported_in_percent() -> None:
    t = np.cumsum(0.05 * (1 + 0.2 * RNG.uniform(-1, 1, 500)))
    found = _found(_run(t, u=RNG.standard_normal(500)))
    assert found["jitter"].severity == "note"
    assert found["jitter"].evidence["jitter"] == pytest.approx(0.2 / np.sqrt(3), rel=0.1)


def test_an_even_clock_with_too_few_digits_is_told_from_one_that_jitters() -> None:
    """Four rows a second with one decimal: steps of 0.2 and 0.3 s."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 100.0, 0.25)
    found = _found(_run(np.round(t, 1), u=rng.standard_normal(len(t))))
    assert "jitter" not in found
    assert found["rounded_times"].severity == "warning"
    assert found["rounded_times"].evidence["interval"] == pytest.approx(0.25, abs=1e-4)
    assert found["rounded_times"].mapping.startswith("[time]\ninterval = ")
    late = np.round(np.cumsum(0.25 * (1 + 0.2 * rng.uniform(-1, 1, 400))), 1)
    assert "jitter" in _found(_run(late, u=rng.standard_normal(400)))


def test_what_many_runs_show_is_said_once_of_the_worst() -> None:
    runs = []
    for k, jitter in enumerate((0.1, 0.3, 0.2)):
        t = np.cumsum(0.1 * (1.0 + jitter * RNG.uniform(-1.0, 1.0, 500)))
        runs.append(replace(_run(t, u=RNG.standard_normal(500)), name=f"dive {k}"))
    (found,) = [f for f in sampling(runs, ["u"], LogMapping()) if f.id == "jitter"]
    assert found.text.startswith("dive 1: sampling is irregular: steps of 0.0")
    assert found.text.endswith("; less so in dive 0, dive 2")


def test_a_log_far_denser_than_the_motion_is_said_with_what_would_do() -> None:
    t = np.arange(0.0, 10.0, 0.0025)
    found = _found(_run(t, u=np.sin(t)), LogMapping.model_validate({"time": {"every": 2}}))["dense"]
    assert found.evidence["rate"] == pytest.approx(400.0)
    assert found.mapping == "[time]\nevery = 40", "of the rows of the file"
    assert "dense" not in _found(_run(np.arange(0.0, 10.0, 0.05), u=RNG.standard_normal(200)))


def _in_bursts(t: np.ndarray, every: float, apart: float) -> np.ndarray:
    """Times at which a link hands over what was taken at times t: all of a while at once."""
    _, which = np.unique(np.floor(t / every), return_index=True)
    nth = np.arange(len(t)) - np.repeat(which, np.diff([*which, len(t)]))
    return every * np.floor(t / every) + apart * nth


def test_rows_that_arrive_in_bursts_are_a_mistake_and_outages_are_none() -> None:
    t = np.arange(0.0, 60.0, 0.05) + 1e-6
    found = _found(_run(_in_bursts(t, 0.3, 0.005), u=np.sin(t)))["bursts"]
    assert found.severity == "mistake"
    assert found.evidence["gaps"] == pytest.approx(199, abs=2)
    out = (t < 10.0) | ((t > 40.0) & (t < 45.0)) | (t > 58.0)  # most of the time, but twice
    assert "bursts" not in _found(_run(t[out], u=np.sin(t[out])))
    pauses = np.cumsum([250.0, 90_000.0, 40.0, 7.0, 60.0] * 10)  # several sessions in one file
    sessions = np.arange(1040.0) + np.repeat(pauses, [1, 1, 1, 1, 100] * 10)
    assert "bursts" not in _found(_run(sessions, u=np.sin(sessions)))


def test_nothing_is_said_of_units_and_signs_where_the_times_are_those_of_arrival() -> None:
    case = make_case("usv", (), 2, duration=40.0, runs=("multisine",))
    (run,) = runs_of(case)
    t = _in_bursts(run.t - run.t[0], 10 * run.step, 0.05 * run.step)
    vehicle, late = vehicle_of(case), replace(run, t=t)
    with pytest.raises(UndertowError, match=r"^log .*: rows come in bursts.* as the column of \[time\], or"):
        refuse_impossible(vehicle, [late])
    found = examine(vehicle, [late]).result.findings
    assert [f.id for f in found if f.severity == "mistake"] == ["bursts"]


def test_missing_rows_are_counted() -> None:
    t = np.arange(0.0, 50.0, 0.05)
    kept = np.ones(len(t), dtype=bool)
    kept[300:400] = False
    kept[10:290:7] = False
    found = _found(_run(t[kept], u=RNG.standard_normal(kept.sum())))["gaps"]
    assert found.severity == "warning"
    assert found.evidence["share"] == pytest.approx(np.mean(~kept), rel=0.02)
    assert found.evidence["gaps"] == 1
    assert "the longest of 5.05 s at t = 14.95 s" in found.text


def test_missing_cells_are_reported_for_the_worst_channel() -> None:
    t = np.arange(0.0, 20.0, 0.05)
    u, v = RNG.standard_normal((2, len(t)))
    u[:100] = np.nan
    v[:20] = np.nan
    found = _found(_run(t, u=u, v=v))["missing_samples"]
    assert "u has no value in 25.0% of the rows (missing samples also in v)" in found.text
    outliers = replace(_run(t, u=u, v=v), outliers={"u": 3})
    assert "of the rows, with 3 outliers that were removed (" in _found(outliers)["missing_samples"].text


def test_a_sensor_slower_than_the_log_gets_a_line() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    slow = np.repeat(np.sin(0.3 * t[::5]) + 0.01 * RNG.standard_normal(120), 5)
    found = _found(_run(t, u=slow, v=np.sin(t) + 0.01 * RNG.standard_normal(len(t))))["held_values"]
    assert found.evidence == {"rows": 5.0, "seconds": pytest.approx(0.5)}
    assert found.mapping == '[columns]\nu = { channel = "u", fresh = "u" }'


def test_a_coarse_reading_is_not_a_slow_one() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    assert "held_values" not in _found(_run(t, z=np.round(0.5 * np.sin(0.1 * t), 2)))


def _filmed(frame: float, late: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A motion seen by a camera, written 200 times a second on straight lines between its frames."""
    t = np.arange(0.0, 30.0, 0.005)
    frames = np.arange(-1.0, 31.0, frame) + late
    seen = 0.1 * np.sin(1.3 * frames) + 1e-3 * RNG.standard_normal(len(frames))
    return t, np.interp(t, frames, seen)


@pytest.mark.parametrize("late", [0.0, 0.0013])
def test_rows_on_straight_lines_between_samples_are_no_measurements(late: float) -> None:
    t, y = _filmed(0.05, late)
    _, z = _filmed(0.05, late)
    found = _found(_run(t, y=y, z=z))["interpolated"]
    assert found.severity == "warning"
    assert found.evidence == {"rows_y": pytest.approx(10.0, abs=0.5), "rows_z": pytest.approx(10.0, abs=0.5)}
    assert found.mapping == "[time]\nevery = 10"


def test_a_slow_sensor_interpolated_beside_a_fast_one_is_to_be_left_blank() -> None:
    t, y = _filmed(0.05)
    found = _found(_run(t, y=y, p=np.cos(1.3 * t) + 1e-3 * RNG.standard_normal(len(t))))["interpolated"]
    assert list(found.evidence) == ["rows_y"]
    assert not found.mapping
    assert "leave the cells between its samples blank" in found.text


def test_smooth_motions_and_held_values_are_not_interpolated() -> None:
    t, y = _filmed(0.05)
    steps = np.repeat(y[::10], 10)[: len(t)]
    steady = 0.3 * t  # the heading of a noiseless turn
    corners = np.interp(t, [0.0, 10.0, 20.0, 30.0], [0.0, 1.0, 0.5, 2.0])
    for column in (np.sin(t), steps, steady, corners, np.round(np.sin(t), 3), np.zeros_like(t)):
        assert "interpolated" not in _found(_run(t, y=column))


def test_a_position_written_with_three_digits_is_not_interpolated() -> None:
    t = np.arange(0.0, 400.0, 0.135)  # a turning circle: the last digit is a centimetre, a decimetre, a metre
    y = 100.0 * (1.0 - np.cos(0.007 * t)) + 0.001 * RNG.standard_normal(len(t))
    rounded = np.array([float(f"{v:.2e}") for v in y])
    assert "interpolated" not in _found(_run(t, y=rounded))


def test_rows_out_of_order_are_a_mistake_until_the_mapping_drops_them() -> None:
    run = replace(_run(np.arange(0.0, 5.0, 0.1), u=RNG.standard_normal(50)), dropped=3)
    found = _found(run)["disorder"]
    assert found.severity == "mistake"
    assert found.mapping == '[time]\ndisorder = "drop"'
    known = LogMapping.model_validate({"time": {"disorder": "drop"}})
    assert _found(run, known)["disorder"].severity == "note"


# --- excitation ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("cut_off", [0.7, 2.0])
def test_a_record_that_was_filtered_is_found_with_its_cut_off(cut_off: float) -> None:
    t, rng = np.arange(0.0, 100.0, 0.05), np.random.default_rng(1)
    noisy = np.cumsum(np.sin(0.3 * t)) * 0.05 + 0.01 * rng.standard_normal(len(t))
    smooth = sosfiltfilt(butter(4, cut_off, fs=20.0, output="sos"), noisy)
    run = _run(t, u=smooth, v=noisy, r=np.round(noisy, 2))
    assert was_filtered([run], ["u", "v", "r", "w"]) == {"u": pytest.approx(cut_off, rel=0.5)}
    assert "u above" in _found(run)["filtered_record"].text
    assert not was_filtered([replace(run, sigma={"u": 0.01})], ["u"]), "the user knows the sensor"


def test_excitation_tells_what_moved_and_what_the_commands_asked_for() -> None:
    case = make_case("usv", (), 2, duration=40.0, runs=("multisine",))
    vehicle, runs = vehicle_of(case), runs_of(case)
    rows = {e.degree_of_freedom: e for e in excitation(vehicle, runs)}
    (columns,) = case.runs.values()
    assert rows["surge"].rms == pytest.approx(np.sqrt(np.mean(columns["u"] ** 2)))
    assert rows["surge"].noise == pytest.approx(0.01, rel=0.15)
    assert rows["surge"].command_range == pytest.approx(np.ptp(columns["f1"]) / 4.0)
    assert rows["yaw"].reversals >= 2
    assert not rows["yaw"].cannot


def test_a_motion_that_was_not_excited_is_a_warning() -> None:
    case = make_case("usv", (), 2, duration=20.0, runs=("multisine",))
    vehicle, (run,) = vehicle_of(case), runs_of(case)
    still = replace(run, channels={**run.channels, "v": 0.01 * RNG.standard_normal(len(run.t))})
    rows = excitation(vehicle, [still])
    (warning,) = [f for f in excitation_findings(rows, vehicle, [still]) if f.severity == "warning"]
    assert warning.text.startswith("sway (v: rms 0.0")
    assert "cannot show anything" in warning.text


def test_one_period_says_no_more_than_two_numbers() -> None:
    """A hull in a regular wave: its damping is zero, or the wave feeds it; two waves would tell."""
    case = make_case("usv", (), 2, duration=40.0, runs=("multisine",))
    vehicle, (run,) = vehicle_of(case), runs_of(case)
    noise = 0.01 * RNG.standard_normal(len(run.t))
    one, two = np.sin(2 * np.pi * run.t / 1.25), np.sin(2 * np.pi * run.t / 2.0)
    sway, yaw = ({**run.channels, name: 0.3 * one + noise} for name in ("v", "r"))
    hull = replace(vehicle, thrusters=())
    rows = {
        n: _cannot(v, replace(run, channels=c))[n]
        for n, v, c in (("sway", hull, sway), ("yaw", vehicle, yaw))
    }
    assert "more than two of inertia, damping and stiffness, nor tell these from a wave" in rows["sway"]
    assert "(one period only, 1.25 s)" in rows["sway"]
    assert "damping and stiffness (one period only" in rows["yaw"], "its thrusters turn it"
    both = replace(run, channels={**run.channels, "v": 0.3 * one + 0.2 * two + noise})
    assert "period" not in _cannot(hull, both)["sway"]


def _cannot(vehicle: Vehicle, run: Run) -> dict[str, str]:
    return {e.degree_of_freedom: "; ".join(e.cannot) for e in excitation(vehicle, [run])}


def test_one_speed_in_one_direction_leaves_drag_open() -> None:
    case = make_case("usv", (), 2, duration=20.0, runs=("multisine",))
    vehicle, (run,) = vehicle_of(case), runs_of(case)
    n = len(run.t)
    steady = {"u": 0.5 + 0.01 * RNG.standard_normal(n), "psi": 0.1 + 0.003 * RNG.standard_normal(n)}
    towed = replace(run, channels={**run.channels, **steady})
    text = "\n".join(f.text for f in excitation_findings(excitation(vehicle, [towed]), vehicle, [towed]))
    assert "added mass (the velocity hardly changes); drag in the other direction" in text
    assert "linear and quadratic drag separately" in text
    assert "a current cannot be distinguished from a constant force" in text


def test_a_clock_that_ticks_when_it_likes_has_lost_no_rows() -> None:
    """An estimator that publishes at the report of each of several sensors; an even one without some rows."""
    of_each = [np.arange(0.0, 60.0, step) for step in (0.0081, 0.0095, 0.0913)]
    t = np.sort(np.concatenate(of_each))
    t = t[np.concatenate([[True], np.diff(t) > 1e-4])]
    found = _found(_run(t, u=np.sin(t)))
    assert "gaps" not in found
    assert "jitter" in found
    even = np.arange(0.0, 60.0, 0.01)
    kept = RNG.random(len(even)) > 0.2
    found = _found(_run(even[kept], u=np.sin(even[kept])))
    assert found["gaps"].evidence["share"] == pytest.approx(0.2, abs=0.03)


# --- lines for mapping files -----------------------------------------------------------------------------
def test_a_column_edit_keeps_what_the_mapping_says_already() -> None:
    mapping = LogMapping.model_validate(
        {"columns": {"hdg": {"channel": "psi", "unit": "rad", "wrapped": True}}}
    )
    edit = column_edit(mapping, "psi", unit="deg")
    assert as_toml([edit]) == '[columns]\nhdg = { channel = "psi", unit = "deg", wrapped = true }'
    assert edited(mapping, [edit]).columns["hdg"].unit == "deg"
    flipped = column_edit(
        LogMapping.model_validate({"columns": {"a": {"channel": "u", "scale": 2, "offset": 1}}}),
        "u",
        times=-1.0,
    )
    assert flipped.value == {"channel": "u", "scale": -2.0, "offset": -1.0}


def test_a_channel_of_a_log_in_enu_is_found_under_its_name_there() -> None:
    mapping = LogMapping.model_validate(
        {"frames": {"position": "ENU", "body": "FLU"}, "columns": {"e": "x", "n": "y"}}
    )
    assert column_edit(mapping, "x", times=-1.0).key == "n"  # north inside
    (v, u) = reassigned(mapping, {"u": ("v", 1.0), "v": ("u", -1.0)})
    assert (v.key, v.value) == ("v", {"channel": "u", "scale": -1.0})
    assert (u.key, u.value) == ("u", {"channel": "v"})


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (("ENU", "FRD", "NED"), {"position": "ENU", "attitude": "NED"}),
        (("ENU", "FLU", "ENU"), {"position": "ENU", "body": "FLU"}),
        (("NED", "FRD", "ENU"), {"attitude": "ENU"}),
        (("NED", "FLU", "NED"), {"body": "FLU", "attitude": "NED"}),
    ],
)
def test_frames_are_said_as_the_mapping_needs_them(
    frames: tuple[str, str, str], said: dict[str, str]
) -> None:
    edits = frames_edits(LogMapping(), *frames)
    assert {e.key: e.value for e in edits} == said
    again = edited(LogMapping(), edits).frames
    assert (again.position, again.body, again.attitude or again.position) == frames


def test_a_mapping_file_keeps_comments_and_odd_names() -> None:
    text = '# mine\nschema = "undertow/mapping/1"\n\n[columns]\n"my heading" = "psi" # the compass\nu = "u"\n'
    edits = (
        Edit("columns", "my heading", {"channel": "psi", "unit": "deg"}),
        Edit("water", "velocity", [0.1, 0.0, 0.0]),
    )
    new = into_file(text, edits)
    assert new.startswith("# mine\n")
    assert '"my heading" = { channel = "psi", unit = "deg" }' in new
    assert new.endswith("[water]\nvelocity = [0.1, 0.0, 0.0]\n")
    whole = into_file(mapping_text(LogMapping()), edits)
    assert whole.startswith('schema = "undertow/mapping/1"\n\n[columns]\n"my heading" = ')


def test_a_formula_is_mended_in_the_formula() -> None:
    mapping = LogMapping.model_validate(
        {
            "columns": {"b": {"channel": "v"}},
            "channels": {"psi": {"expression": "a + pi", "delay": "0.1 s"}, "u": "sin(a)", "w": "cos(a)"},
        }
    )
    degrees = column_edit(mapping, "psi", unit="deg", wrapped=True)
    assert as_toml([degrees]) == (
        '[channels]\npsi = { expression = "a + pi", unit = "deg", delay = "0.1 s", wrapped = true }'
    )
    assert edited(mapping, [degrees]).channels["psi"].wrapped
    flipped = column_edit(mapping, "psi", times=-1.0, offset=90.0)
    assert edited(mapping, [flipped]).channels["psi"].expression == "-1 * (a + pi) + 90"
    exchanged = edited(mapping, reassigned(mapping, {"u": ("w", 1.0), "w": ("u", -1.0)})).channels
    assert (exchanged["u"].expression, exchanged["w"].expression) == ("cos(a)", "-1 * (sin(a))")
    assert not reassigned(mapping, {"u": ("v", 1.0), "v": ("u", 1.0)})  # the formula would have to go
    late = delay_edit(mapping, "psi", 0.2)
    assert edited(mapping, [late]).channels["psi"].delay == "0.3 s"


def test_a_rudder_without_force_at_rest_has_no_range_of_commanded_force() -> None:
    """Its thrust per command is zero, so there is nothing to compare the commands with (not 0 / 0)."""
    case = make_case("usv", (), 2, duration=20.0, runs=("multisine",))
    vehicle, runs = vehicle_of(case), runs_of(case)
    thrusters = tuple(replace(t, thrust_per_command=Value(0.0)) for t in vehicle.thrusters)
    rows = excitation(replace(vehicle, thrusters=thrusters), runs)
    assert [row.command_range for row in rows] == [None] * len(rows)


def test_logs_too_short_for_a_fit_are_told_before_one_is_tried() -> None:
    case = make_case("mini-auv", (), 6, duration=20.0, runs=("multisine",))
    vehicle, (run,) = vehicle_of(case), runs_of(case)
    findings = {n: examine(vehicle, [run.head(n)]).result.findings for n in (12, len(run.t))}
    said = {n: [f.text for f in found if f.id == "not_fitted"] for n, found in findings.items()}
    assert not said[len(run.t)]
    (text,) = said[12]
    assert "commands were not checked: too few samples without a gap" in text


def test_a_formula_of_a_slow_sensor_gets_a_line_if_it_has_one_column() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    held = np.floor(t + 1e-9) ** 1.5
    for expression, line in (("2 * lat", 'fresh = "lat"'), ("lat + lon", "")):
        mapping = LogMapping.model_validate({"channels": {"x": expression}})
        found = _found(_run(t, x=held), mapping)["held_values"]
        assert line in found.mapping
        assert bool(line) == bool(found.mapping)
