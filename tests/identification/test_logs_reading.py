"""Reading logs: what comes out is SI, gaps stay gaps, and every fault is one line naming its place."""

from __future__ import annotations

import gzip
import hashlib
import io
import math
import tracemalloc
import zipfile
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from decimal import Decimal

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from undertow.errors import UndertowError
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.mapping import LogMapping, mapping_beside
from undertow.identification.logs.opening import refuse_constant
from undertow.identification.logs.reading import read_log, read_logs
from undertow.identification.logs.table import WHOLE
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value

PLAIN = "t,u,r,f1\n0,0.1,0.0,1\n0.1,0.2,0.1,2\n0.25,,0.2,3\n"


@pytest.fixture
def log(tmp_path):
    """Return a function that writes a log and reads it."""

    def read(content, mapping=None, channels=(), name="run.csv", **options):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_log(path, LogMapping.model_validate(mapping or {}), channels, **options)

    return read


def refused(log, content, *parts, **options):
    with pytest.raises(UndertowError) as caught:
        log(content, **options)
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message, message


def test_a_plain_log_keeps_gaps_and_uneven_sampling(log):
    run = log(PLAIN, channels=["f1"])
    assert run.name == "run"
    assert run.sha256 == hashlib.sha256(PLAIN.encode()).hexdigest()
    np.testing.assert_array_equal(run.t, [0, 0.1, 0.25])
    np.testing.assert_array_equal(run.channels["u"], [0.1, 0.2, np.nan])
    np.testing.assert_array_equal(run.channels["f1"], [1, 2, 3])
    assert sorted(run.channels) == ["f1", "r", "u"]


def test_gzip_parquet_and_csv_give_the_same_run(log, tmp_path):
    pl.read_csv(PLAIN.encode()).write_parquet(tmp_path / "made.parquet")
    packed = (tmp_path / "made.parquet").read_bytes()
    runs = [
        log(PLAIN),
        log(gzip.compress(PLAIN.encode()), name="run.csv.gz"),
        log(packed, name="run.parquet"),
        log("\ufeff" + PLAIN.replace("\n", "\r\n")),
    ]
    for run in runs[1:]:
        np.testing.assert_array_equal(run.matrix(["u", "r"]), runs[0].matrix(["u", "r"]))


def test_columns_that_nobody_asked_for_are_left_out_and_told(log):
    run = log("t,u,battery,f1\n0,1,12,1\n1,2,12,2\n", channels=["f1"])
    assert not run.has("battery")
    assert "columns not used: battery" in run.notes
    numbered = log(",t,u\n0,0,1\n1,1,2\n")  # the row numbers of a data frame
    assert "columns not used: (column 1 has no name)" in numbered.notes
    ignoring = log("t,u,battery\n0,1,12\n1,2,12\n", {"ignore": ["battery"]})
    assert not any("battery" in note for note in ignoring.notes)


def test_a_mapping_converts_units_scale_and_offset(log):
    mapping = {
        "time": {"column": "ms", "unit": "ms", "offset": 10},
        "columns": {
            "heading": {"channel": "psi", "unit": "deg", "offset": 5},
            "speed": {"channel": "u", "unit": "knot"},
            "pwm": {"channel": "f1", "unit": "kN", "scale": 0.5},
        },
    }
    run = log("ms,heading,speed,pwm\n0,350,1,2\n100,353,2,4\n200,2,3,6\n", mapping, ["f1"])
    np.testing.assert_allclose(run.t, [10, 10.1, 10.2])
    np.testing.assert_allclose(np.degrees(run.channels["psi"]), [355, 358, 367])
    np.testing.assert_allclose(run.channels["u"], np.array([1, 2, 3]) * 1852 / 3600)
    np.testing.assert_allclose(run.channels["f1"], [1000, 2000, 3000])
    assert any("psi = 0.0174" in note and "f1 = 500 pwm" in note for note in run.notes)


def test_psi_is_unwrapped_across_a_gap_and_other_angles_only_when_asked(log):
    text = "t,psi,phi\n" + "".join(f"{k},{v},{v}\n" for k, v in enumerate([3.0, 3.1, "", -3.1, -3.0]))
    run = log(text)
    turn = 2 * math.pi
    np.testing.assert_allclose(run.channels["psi"], [3.0, 3.1, np.nan, turn - 3.1, turn - 3.0])
    np.testing.assert_allclose(run.channels["phi"], [3.0, 3.1, np.nan, -3.1, -3.0])
    asked = log(text, {"columns": {"phi": {"channel": "phi", "wrapped": True}}})
    np.testing.assert_allclose(asked.channels["phi"], run.channels["psi"])


@pytest.mark.parametrize("interval", [0.9, 1.0, 2.6])
@pytest.mark.parametrize("rate", [0.05, -0.05])
def test_a_heading_resampled_across_its_jump_lacks_the_samples_in_between(log, interval, rate):
    slow, t, start = np.arange(0.0, 61.0, interval), np.arange(0.0, 59.0, 0.5), 3.14 + 1.6 * np.sign(rate)
    wrapped = np.degrees(start + rate * slow) % 360
    psi = np.interp(t, slow, wrapped)
    run = log("t,psi\n" + "".join(f"{a},{b}\n" for a, b in zip(t, np.radians(psi), strict=True)))
    true, there = start + rate * t, np.isfinite(run.channels["psi"])
    np.testing.assert_allclose(np.sin(run.channels["psi"][there] - true[there]), 0.0, atol=1e-9)
    assert np.ptp(np.round((run.channels["psi"] - true)[there], 6)) == 0.0  # no turn too many
    lost = np.abs(np.angle(np.exp(1j * (np.radians(psi) - true)))) > 1e-6
    assert lost.any()
    np.testing.assert_array_equal(~there, lost)
    assert run.wrapped["psi"][lost] == pytest.approx(np.radians(psi)[lost])


def test_a_vehicle_at_rest_may_turn_nearly_once_around(log):
    t = np.arange(0.0, 400.0, 0.5)
    psi = 0.05 + np.clip(0.6 * (t - 300.0), 0.0, 6.15)
    run = log("t,psi\n" + "".join(f"{a},{b}\n" for a, b in zip(t, psi, strict=True)))
    np.testing.assert_array_equal(run.channels["psi"], psi)


def test_a_heading_of_a_vehicle_that_spins_is_left_as_it_is(log):
    t = np.arange(0.0, 30.0, 0.2)
    rate = np.where(t % 10 < 5, 4.0, 0.0)
    true = np.cumsum(rate) * 0.2
    run = log("t,psi\n" + "".join(f"{a},{b}\n" for a, b in zip(t, true % (2 * np.pi), strict=True)))
    np.testing.assert_allclose(np.diff(run.channels["psi"]), np.diff(true), atol=1e-9)


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        (["2024-05-01T12:00:00.250Z", "2024-05-01T12:00:00.500Z", "2024-05-01T12:00:01Z"], "iso"),
        (["2024-05-01 23:59:59.750", "2024-05-02 00:00:00", "2024-05-02 00:00:00.5"], "iso"),
        (["23:59:59.750", "00:00:00.000", "00:00:00.500"], "iso"),
        (["05/01/2024 23:59:59.750", "05/02/2024 00:00:00", "05/02/2024 00:00:00.5"], "iso"),
        (["31.12.2024 23:59:59.750", "01.01.2025 00:00:00", "01.01.2025 00:00:00.5"], "iso"),
        (["12/31/2024 11:59:59.750 PM", "1/1/2025 12:00:00 AM", "1/1/2025 12:00:00.5 AM"], "iso"),
        (["30-Apr-2024 23:59:59.750", "01-May-2024 00:00:00", "01-May-2024 00:00:00.5"], "iso"),
        (["1714564800250000000", "1714564800500000000", "1714564801000000000"], "ns"),
        (["1714564800.25", "1714564800.5", "1714564801.0"], "s"),
    ],
)
def test_dates_and_epochs_count_from_the_first_sample(log, stamps, unit):
    text = "t,u\n" + "".join(f"{stamp},{k}\n" for k, stamp in enumerate(stamps))
    run = log(text, {"time": {"unit": unit}})
    np.testing.assert_allclose(run.t, [0, 0.25, 0.75], atol=1e-6)
    assert any("time starts at" in note for note in run.notes)


def test_a_date_in_the_name_of_a_file_belongs_to_the_name_of_its_run(tmp_path):
    first, second, packed = (tmp_path / f"dive.2024-05-{end}" for end in ("01.csv", "02.csv", "03.csv.gz"))
    first.write_text(PLAIN)
    second.write_text(PLAIN)
    packed.write_bytes(gzip.compress(PLAIN.encode()))
    names = [read_log(path).name for path in (first, second, packed)]
    assert names == ["dive.2024-05-01", "dive.2024-05-02", "dive.2024-05-03"]
    (tmp_path / "dive.2024-05-02.toml").write_text('schema = "undertow/mapping/1"\ndescription = "second"')
    assert mapping_beside(first) is None
    assert mapping_beside(second).description == "second"


def test_dates_of_a_parquet_file_need_no_unit(tmp_path):
    stamps = pl.Series("t", ["2024-05-01T12:00:00", "2024-05-01T12:00:02"]).str.to_datetime()
    pl.DataFrame({"t": stamps, "u": [1, 2], "f1": [True, False]}).write_parquet(tmp_path / "a.parquet")
    run = read_log(tmp_path / "a.parquet", channels=["f1"])
    np.testing.assert_array_equal(run.t, [0, 2])
    np.testing.assert_array_equal(run.channels["f1"], [1, 0])


def test_sentinels_delimiter_decimal_comma_and_comments(log):
    mapping = {"delimiter": ";", "decimal": ",", "comment": "#", "missing": ["lost", -9999]}
    run = log("# logger 3\nt ; u;v;w\n0; 0,5;lost;1\n1;-9999;0,25;NA\n2;1,5;-9999,0;2\n", mapping)
    np.testing.assert_array_equal(run.channels["u"], [0.5, np.nan, 1.5])
    np.testing.assert_array_equal(run.channels["v"], [np.nan, 0.25, np.nan])
    np.testing.assert_array_equal(run.channels["w"], [1, np.nan, 2])


def test_enu_and_flu_become_ned_and_frd(log):
    mapping = {"frames": {"position": "ENU", "body": "FLU"}}
    text = "t,x,y,z,theta,psi,u,v,r\n0,10,20,-3,0.1,0.2,1,2,0.3\n1,11,21,-4,0.1,0.3,1,2,0.4\n"
    run = log(text, mapping)
    first = {name: data[0] for name, data in run.channels.items()}
    expected = {"x": 20, "y": 10, "z": 3, "theta": -0.1, "psi": math.pi / 2 - 0.2, "u": 1, "v": -2, "r": -0.3}
    assert first == pytest.approx(expected)
    assert any("converted to NED/FRD" in note for note in run.notes)
    mixed = {"frames": {"position": "ENU"}}
    refused(log, text, "does not define the angles", 'attitude = "NED"', mapping=mixed)
    mixed["frames"]["attitude"] = "NED"
    assert log(text, mixed).channels["psi"][0] == 0.2


def test_a_time_window_is_cut_before_the_checks(log):
    run = log("t,u,f1\n0,inf,\n1,1,1\n2,2,2\n3,3,3\n", channels=["f1"], window=(1, 2.5))
    np.testing.assert_array_equal(run.t, [1, 2])
    refused(log, PLAIN, "no sample in the time window 7 to inf s", "lasts from 0 to 0.25 s", window=(7, None))
    refused(log, PLAIN, "one sample in the time window", window=(0.2, None))


def test_missing_commands_follow_the_policy(log):
    text = "t,u,f1\n0,0,1\n1,1,\n2,2,\n3,3,4\n"
    reported = "command 'f1' is missing in 2 of 4 rows (t = 1 to 2 s)"
    refused(log, text, reported, 'missing_commands = "hold"', channels=["f1"])
    held = log(text, {"missing_commands": "hold"}, ["f1"])
    np.testing.assert_array_equal(held.channels["f1"], [1, 1, 1, 4])
    assert f"{reported}; the last value was held" in held.notes
    left = log(text, None, ["f1"], missing_commands="gap")
    np.testing.assert_array_equal(left.channels["f1"], [1, np.nan, np.nan, 4])
    later = log(text.replace("0,0,1\n1,1,", "0,0,\n1,1,5"), None, ["f1"], missing_commands="hold")
    np.testing.assert_array_equal(later.t, [1, 2, 3])  # begins with the first command
    assert "1 s at the beginning and 0 s at the end left out for lack of a command" in later.notes
    apart = "t,u,f1,f2\n0,0,1,\n1,1,,3\n"
    refused(log, apart, "begin later (--from)", channels=["f1", "f2"], missing_commands="hold")


def test_cells_may_state_their_unit(log):
    """As loggers of motor drives write them: "1.757V"."""
    text = "t,u,voltage,f1\n0,0.1,1.757V,50%\n1,0.2,1.5 V,-25%\n2,0.3,,0%\n"
    run = log(text, {"columns": {"voltage": {"channel": "volts"}}}, ["f1"])
    np.testing.assert_array_equal(run.channels["volts"], [1.757, 1.5, np.nan])
    np.testing.assert_allclose(run.channels["f1"], [0.5, -0.25, 0.0])
    stated = {"columns": {"voltage": {"channel": "volts", "unit": "mV"}}}
    refused(log, text, "'voltage' state V, but the mapping file mV", 'unit = "V"', mapping=stated)
    mixed = {"columns": {"voltage": {"channel": "volts"}}}
    refused(log, text.replace("1.5 V", "1.5 A"), "has the text '1.757V' in row 1", mapping=mixed)


def test_texts_among_numbers_are_missing_where_the_mapping_says_so(log):
    """A spreadsheet that takes decimals for dates: 1.45 becomes jan.45, 3.48 mar.48."""
    text = "t,u,r\n0,0.1,0.2\n1,jan.45,0.3\n2,0.3,mar.48\n3,04.feb,0.1\n"
    refused(log, text, "has the text 'jan.45' in row 2 (2 such rows)", 'not_numbers = "missing"')
    run = log(text, {"not_numbers": "missing"})
    np.testing.assert_array_equal(run.channels["u"], [0.1, np.nan, 0.3, np.nan])
    assert "column 'u': 2 cells such as 'jan.45' are missing" in run.notes


def test_fractions_of_a_second_without_their_zeros(log):
    """Nanoseconds printed as they count, so that 93 ms come after 992 ms and before 102 ms."""
    stamps = ["46.992337475", "47.93734532", "47.195102881", "47.295000000", "48.7000001"]
    rows = "".join(f"2025/04/09 11:15:{s},{k}\n" for k, s in enumerate(stamps))
    run = log("t,u\n" + rows, {"time": {"unit": "iso"}})
    expected = np.array([46.992337475, 47.093734532, 47.195102881, 47.295, 48.007000001])
    np.testing.assert_allclose(run.t, expected - expected[0], atol=1e-9)
    assert any("2 times such as '2025/04/09 11:15:47.93734532' lack zeros" in n for n in run.notes)
    late = "".join(f"2025/04/09 11:15:{stamps[k]},{k}\n" for k in (0, 1, 3, 2, 4))
    run = log("t,u\n" + late, {"time": {"unit": "iso", "disorder": "drop"}})
    np.testing.assert_allclose(run.t, np.delete(expected, 2) - expected[0], atol=1e-9)
    sound = "t,u\n2025-04-09T11:15:46.5,1\n2025-04-09T11:15:46.55Z,2\n2025-04-09T11:15:46.6,3\n"
    np.testing.assert_allclose(log(sound.replace("Z", ""), {"time": {"unit": "iso"}}).t, [0, 0.05, 0.1])


def test_a_command_may_be_made_of_two_clocks(log):
    """Revolutions and the angle of an azimuth thruster, each stamped by its own controller."""
    t = np.arange(0.0, 30.0, 0.1)
    rows = [(s, f"{np.sin(s):.6f},,") for s in t]
    rows += [(s + 0.03, f",{10 + (s > 15):g},") for s in t]
    rows += [(s + 0.06, f",,{0.5 if s > 20 else 0.0:g}") for s in t]
    text = "t,u,rev,angle\n" + "".join(f"{s:.3f},{cells}\n" for s, cells in sorted(rows))
    thrust = {"channels": {"f1": {"expression": "2*rev**2*cos(angle)", "unit": "N"}}}
    run = log(text, thrust, ["f1"])
    known = run.t > 1.0
    expected = 2 * (10.0 + (run.t > 15.1)) ** 2 * np.where(run.t > 20.1, np.cos(0.5), 1.0)
    off = np.abs(run.channels["f1"] - expected)[known] > 1e-6
    assert off.sum() <= 4, "but for the rows in which one of them changes"
    apart = {"channels": {"psi": {"expression": "rev*angle", "unit": "rad"}}}
    refused(log, text, "channel 'psi', rev and angle, have no row in common", mapping=apart)


def test_rows_of_one_time_that_complement_each_other_are_one_row(log, tmp_path):
    """Topics below each other; rows that repeat each other are one, those that contradict are refused."""
    text = "t,u,r\n" + "".join(f"{k / 10:.1f},{k},\n{k / 10:.1f},,{k / 100}\n" for k in range(9))
    run = log(text + "0.9,9,\n0.9,9,\n")
    np.testing.assert_allclose(run.t, np.arange(10) / 10)
    np.testing.assert_array_equal(run.channels["u"], np.arange(10.0))
    np.testing.assert_allclose(run.channels["r"][:9], np.arange(9) / 100)
    assert "10 rows joined with the one before, of the same time" in run.notes
    assert run.dropped == 0
    path = tmp_path / "run.csv"
    parts = [part.run for part in LongLog(path, LogMapping(), ()).parts(5, 0)]
    for channel in "ur":
        joined = np.concatenate([part.channels[channel] for part in parts])
        np.testing.assert_array_equal(joined, run.channels[channel])
    refused(log, text + "0.8,7,\n", "has 2 duplicate stamps, first 0.8 s")


def test_a_constant_channel_is_noted_and_refused_on_demand(log):
    run = log("t,u,v\n0,1,0.5\n1,2,0.5\n2,3,\n")
    assert "constant channels (unused, or a dead sensor): v = 0.5" in run.notes
    refuse_constant(run, ["u"])
    with pytest.raises(UndertowError, match=r"v = 0\.5 over all 3 samples"):
        refuse_constant(run, ["u", "v"])


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ("", ["is empty (0 bytes)"]),
        ("\n\n", ["is empty (no header)"]),
        ("t,u\n", ["no sample"]),
        ("t,u\n0,1\n", ["one sample (t = 0 s)", "at least 2"]),
        ("time,u\n0,1\n1,2\n", ["no time column 't'", "did you mean 'time'?", "time, u"]),
        ("t;u\n0;1\n1;2\n", ["delimiter = ';'"]),
        ("t,u\n0,1\n2,2\n1,3\n", ["goes back from 2 to 1 s at row 3", "sort the file"]),
        ("t,u\n0,1\n1,2\n1,3\n", ["1 duplicate stamps, first 1 s at row 3"]),
        ("t,u\n0,1\n,2\n2,3\n", ["is missing in 1 of 3 rows, first in row 2"]),
        ("t,u\n0,1\ninf,2\n", ["is infinite in 1 of 2 rows, first in row 2"]),
        ("t,u\n0,1\n1,inf\n", ["'u' is infinite in 1 of 2 samples, first at t = 1 s"]),
        ("t,u,v\n0,1,\n1,2,NaN\n", ["'v' has no value in any of 2 samples", "`ignore`"]),
        ("t,u\n0,1\n1,fast\n", ["column 'u' has the text 'fast' in row 2 (1 such rows)"]),
        ("t,u,u\n0,1,2\n1,2,3\n", ["column 'u' more than once"]),
        ("t,u\n0,1\n1,2,3\n", ["cannot be read as a table", "line 3 has 3 cells, the header 2"]),
        ("START\nt,u\n0,1\n", ["line 2 has 2 cells, the header 1", "neither header nor data"]),
        ("t,u\n0,1\n1,é\n".encode("latin-1"), ["column 'u' has the text 'é' in row 2"]),
        ("t,u\n0,1\n1,é\0\n".encode("latin-1"), ["not UTF-8", "byte 10 is 0xe9"]),
        ("t,u\n0,1\n".encode("utf-16"), ["not UTF-8"]),
        (gzip.compress(PLAIN.encode() * 50, mtime=0)[:40], ["damaged gzip"]),
        (b"PAR1 and then nothing", ["cannot be read as a table"]),
    ],
)
def test_bad_files_are_one_clear_line(log, content, parts):
    refused(log, content, "run.csv", *parts)


def test_missing_columns_are_named_with_those_there_are(log):
    parts = ["no command channel 'f2'", "did you mean 'f1'?", "t, u, r, f1"]
    refused(log, PLAIN, *parts, channels=["f1", "f2"])
    other_case = ["no command channel 'R'", "did you mean 'r'?"]
    refused(log, PLAIN, *other_case, channels=["R"])
    trailing = "t;u;\n0;0.1;\n0.1;0.2;\n"
    refused(log, trailing, "its columns are t, u; name", channels=["f1"], mapping={"delimiter": ";"})
    mapping = {"columns": {"heading": "psi"}}
    refused(log, PLAIN, "no column for channel 'psi', 'heading'", mapping=mapping)
    assert not log(PLAIN, {"columns": {"heading": {"channel": "psi", "optional": True}}}).has("psi")


@pytest.mark.parametrize(
    ("column", "parts"),
    [
        ({"channel": "psi", "unit": "m"}, ["unit 'm' of column 'r'", "[length]", "rad"]),
        ({"channel": "psi", "unit": "degg"}, ["unit 'degg' is not understood"]),
        ({"channel": "f1", "unit": "9^9^9^9"}, ["is not understood"]),
    ],
)
def test_units_that_do_not_fit_are_refused(log, column, parts):
    refused(log, PLAIN, *parts, mapping={"columns": {"r": column}})


def test_time_that_is_no_time(log):
    refused(log, PLAIN, "time unit 'kg'", "[mass]", mapping={"time": {"unit": "kg"}})
    refused(log, PLAIN, "'0' in row 1 is not an ISO 8601 time stamp", mapping={"time": {"unit": "iso"}})


def test_paths_that_are_no_file(tmp_path):
    with pytest.raises(UndertowError, match="does not exist"):
        read_log(tmp_path / "nothing*.csv")
    with pytest.raises(UndertowError, match="is a folder"):
        read_log(tmp_path)


def test_a_million_rows_are_read_whole(tmp_path):
    n = 1_000_000
    t = np.arange(n) * 0.05
    pl.DataFrame({"t": t, "u": np.sin(t), "f1": np.cos(t)}).write_csv(tmp_path / "long.csv")
    run = read_log(tmp_path / "long.csv", channels=["f1"])
    assert len(run.t) == n
    np.testing.assert_array_equal(run.channels["u"], np.sin(t))
    assert run.segments() == [slice(0, n)]


finite = st.floats(-1e9, 1e9)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(
    steps=arrays(float, 20, elements=st.floats(1e-3, 10)),
    values=arrays(float, (20, 2), elements=st.one_of(finite, st.just(float("nan")))),
)
def test_what_is_written_is_read(tmp_path, steps, values):
    values[0] = 1.0  # a channel without any value is refused
    t = np.cumsum(steps)
    path = tmp_path / "round.csv"
    pl.DataFrame({"t": t, "u": values[:, 0], "v": values[:, 1]}).fill_nan(None).write_csv(path)
    run = read_log(path)
    np.testing.assert_array_equal(run.t, t)
    np.testing.assert_array_equal(run.matrix(["u", "v"]), values)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(angles=arrays(float, 10, elements=st.floats(-400, 400)))
def test_degrees_become_radians_up_to_whole_turns(tmp_path, angles):
    path = tmp_path / "angles.csv"
    pl.DataFrame({"t": np.arange(10.0), "heading": angles}).write_csv(path)
    mapping = LogMapping.model_validate({"columns": {"heading": {"channel": "psi", "unit": "deg"}}})
    psi = read_log(path, mapping).channels["psi"]
    there = np.isfinite(psi)  # others count as resampled across a jump
    assert np.all(np.abs(np.diff(psi[there])) <= np.pi + 1e-9)
    np.testing.assert_allclose(np.exp(1j * psi)[there], np.exp(1j * np.radians(angles))[there], atol=1e-9)


@settings(max_examples=200)
@given(st.binary(max_size=60))
def test_any_bytes_give_a_run_or_one_clear_line(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "bytes.csv"
    path.write_bytes(content)
    message = ""
    try:
        read_log(path)
    except UndertowError as error:
        message = str(error)
    assert "\n" not in message


def test_rows_out_of_order_are_refused_or_dropped(log):
    text = "t,u,r,f1\n0,1,0,1\n0.1,2,0,1\n0.1,3,0,1\n0.05,4,0,1\n0.2,5,0,1\n"
    refused(log, text, "goes back from 0.1 to 0.05 s", "row 4")
    run = log(text, {"time": {"disorder": "drop"}})
    np.testing.assert_array_equal(run.t, [0, 0.1, 0.2])
    np.testing.assert_array_equal(run.channels["u"], [1, 2, 5])
    assert run.dropped == 2
    assert any("2 rows left out" in note and "first t = 0.1 s, row 3" in note for note in run.notes)
    refused(log, "t,u\n0,1\n,2\n1,3\n", "missing", mapping={"time": {"disorder": "drop"}})


def test_a_damaged_heading_leaves_the_others_as_they_are(log):
    rows = (f"{0.1 * i},{0.01 * i if i != 7 else -7.3e307}" for i in range(30))
    psi = log("\n".join(["t,psi", *rows])).channels["psi"]
    np.testing.assert_allclose(np.delete(psi, 7), 0.01 * np.delete(np.arange(30), 7), atol=1e-12)


def test_angles_are_kept_as_they_jump_in_the_log(log):
    run = log("t,psi,u\n0,3.1,1\n1,-3.1,1\n2,-3.0,2\n")
    np.testing.assert_allclose(run.channels["psi"], [3.1, -3.1 + 2 * math.pi, -3.0 + 2 * math.pi])
    np.testing.assert_array_equal(run.wrapped["psi"], [3.1, -3.1, -3.0])
    np.testing.assert_array_equal(run.slice(1, 2).wrapped["psi"], [-3.1, -3.0])
    assert not log("t,psi\n0,0.1\n1,0.2\n").wrapped


def test_velocities_along_the_earth_and_through_the_water(log):
    text = "t,psi,u,v,r\n0,1.5707963267948966,0,2,0\n1,1.5707963267948966,0,2,0\n"
    run = log(text, {"frames": {"velocity": "NED"}})
    np.testing.assert_allclose(run.channels["u"], 2, atol=1e-12)  # heading east, moving east
    np.testing.assert_allclose(run.channels["v"], 0, atol=1e-12)
    assert "u, v, w converted to body axes from NED" in run.notes
    drifting = log(text, {"water": {"velocity": [0.0, 0.5, 0.0]}})
    np.testing.assert_allclose(drifting.channels["u"], 0.5, atol=1e-12)
    np.testing.assert_allclose(drifting.channels["v"], 2, atol=1e-12)
    refused(
        log,
        "t,u,v\n0,1,2\n1,2,3\n",
        "channel, which velocities in NED need",
        "'psi'",
        mapping={"frames": {"velocity": "NED"}},
    )


def test_a_run_knows_how_it_was_read(log):
    mapping = {"columns": {"heading": {"channel": "psi", "unit": "deg"}}}
    assert log("t,heading\n0,1\n1,2\n", mapping).mapping == LogMapping.model_validate(mapping)


def test_a_log_may_be_thinned_out(log):
    rows = "t,phi\n" + "\n".join(f"{k / 100},{k}" for k in range(23))
    run = log(rows, {"time": {"every": 5}})
    np.testing.assert_allclose(run.t, [0.0, 0.05, 0.10, 0.15, 0.20])
    np.testing.assert_array_equal(run.channels["phi"], [0, 5, 10, 15, 20])
    assert "one row in 5 used" in run.notes


def test_thinned_out_a_log_of_several_clocks_keeps_what_reports_rarely(log):
    """Commands have rows of their own, one in twelve, and so has the depth."""

    def row(k):
        if k % 12 == 7:
            return f"{k / 100},,,{(-1) ** (k // 12)}"
        return f"{k / 100},{k},{k if k % 12 == 3 else ''},"

    rows = "t,x,z,c\n" + "\n".join(map(row, range(240)))
    held = {"missing_commands": "hold", "columns": {"c": "port"}}
    whole, thin = log(rows, held, ["port"]), log(rows, {**held, "time": {"every": 5}}, ["port"])
    assert set(thin.channels["z"][thin.reported["z"]]) == set(range(15, 240, 12)), "every depth since then"
    assert len(thin.t) < 240 / 5 + 240 / 12, "and few of the rest"
    impulse, kept = (np.cumsum(np.diff(run.t) * run.channels["port"][:-1]) for run in (whole, thin))
    at = np.interp(thin.t[1:], whole.t[1:], impulse - np.interp(thin.t[1], whole.t[1:], impulse))
    np.testing.assert_allclose(kept - kept[0], at, atol=1e-9, err_msg="no command is held beyond its next")


# --- what is too large --------------------------------------------------------------------------


def _parts(path, mapping=None):
    return list(LongLog(path, mapping or LogMapping(), ()).parts(100, 10))


def test_a_small_file_that_unpacks_to_much_is_refused_before_it_is_unpacked(log):
    """What is held meanwhile is bounded by the limit, not by what would come: 100 MB of text in 0.1 MB."""
    row = b"0" * 99_999 + b"\n"
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb") as stream:
        stream.write(b"t,u\n")
        for _ in range(1_000):
            stream.write(row)
    limits = replace(WHOLE, text=5_000_000)
    tracemalloc.start()
    try:
        refused(
            log,
            packed.getvalue(),
            "run.csv.gz",
            "more than 5 MB unpacked",
            name="run.csv.gz",
            limits=limits,
        )
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("limits", "parts"),
    [
        ({"cells": 3_000}, ["1001 rows of 3 columns or more, at most 1000 such rows can be read as a whole"]),
        ({"columns": 2}, ["has 3 columns, at most 2"]),
        ({"rows": 500}, ["more than 500 rows", "--from and --to", "decimate it"]),
        ({"text": 1_000}, ["more than 0.001 MB"]),
    ],
)
@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz"])
def test_logs_that_are_too_large_are_refused_before_they_are_a_table(log, name, limits, parts):
    text = ("t,u,v\n" + "0,0,0\n" * 1_000).encode()
    content = gzip.compress(text) if name.endswith("gz") else text
    refused(log, content, name, *parts, name=name, limits=replace(WHOLE, **limits))


def test_a_parquet_file_of_countless_equal_rows_is_refused_by_its_footer(log, tmp_path):
    pl.select(t=pl.repeat(0.0, 30_000_000), u=pl.repeat(1.0, 30_000_000)).write_parquet(
        tmp_path / "a.parquet"
    )
    content = (tmp_path / "a.parquet").read_bytes()
    assert len(content) < 1_000_000
    refused(log, content, "30000000 rows of 2 columns", "at most 25000000", name="run.parquet")


@pytest.mark.parametrize("end", [b"", b"0,1\n"])
def test_a_line_that_does_not_end_is_not_read_to_its_end(tmp_path, end):
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(b"t,u\n0,1\n0.1," + b"0" * 3_000_000 + end))
    with pytest.raises(UndertowError, match="line of more than 1000000 bytes"):
        _parts(path)


def test_archives_are_named(log):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as packed:
        packed.writestr("run.csv", PLAIN)
    refused(log, stream.getvalue(), "packed by zip", "gzip")
    refused(log, gzip.compress(stream.getvalue()), "packed by zip", name="run.csv.gz")


@pytest.mark.parametrize(
    ("part", "content"),
    [
        ("xl/workbook.xml", b"<workbook/>"),
        ("mimetype", b"application/vnd.oasis.opendocument.spreadsheet"),
    ],
)
def test_spreadsheets_are_named(log, part, content):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as packed:
        packed.writestr(part, content)
    refused(log, stream.getvalue(), "is a spreadsheet: save the sheet with the log as CSV")


@pytest.mark.parametrize("rows", ["0,1,2,3,4\n1,2,3,4,5\n", "0,1,2,,\n1,2,3,,\n"])
def test_columns_without_a_name_are_left_out(log, rows):
    run = log("t,u,f1,,\n" + rows, channels=["f1"])
    np.testing.assert_array_equal(run.channels["f1"], [2, 3])


@pytest.mark.parametrize("fault", ["cut", "flipped", "ended", "checksum"])
def test_a_damaged_gzip_file_is_one_line_whole_and_in_parts(log, tmp_path, fault):
    rng = np.random.default_rng(1)
    text = "t,u\n" + "".join(f"{k},{v}\n" for k, v in enumerate(rng.standard_normal(5_000)))
    whole = bytearray(gzip.compress(text.encode()))
    if fault == "flipped":
        whole[len(whole) // 2 : len(whole) // 2 + 40] = b"\xff" * 40
    content = {"cut": whole[:-2000], "ended": whole[:12], "checksum": whole[:-8] + bytes(8)}.get(fault, whole)
    refused(log, bytes(content), "damaged gzip", "copy it again", name="run.csv.gz")
    with pytest.raises(UndertowError, match=r"cannot be read|not a number|has the text|copy it again"):
        _parts(tmp_path / "run.csv.gz")


def test_a_damaged_parquet_file_is_one_line(log):
    """Some damages make the reader panic or abort; nothing of that reaches this process."""
    stream = io.BytesIO()
    t = np.arange(300) * 0.1
    pl.DataFrame({"t": t, "u": t % 7, "n": [1] * 300}).write_parquet(stream)
    whole, rng, reported, count = stream.getvalue(), np.random.default_rng(2), 0, 0
    for _ in range(150):
        content = bytearray(whole)
        content[rng.integers(4, len(whole) - 4)] = rng.integers(256)
        try:
            log(bytes(content), name="run.parquet")
        except UndertowError as error:
            reported += "run.parquet" in str(error) and "\n" not in str(error)
            count += 1
    assert reported == count > 30


# --- odd columns --------------------------------------------------------------------------------


@pytest.mark.parametrize("header", ["t,u, u", "t,u,u", 't,"u ",u'])
def test_columns_that_differ_by_blanks_only_are_one_name(log, header):
    refused(log, f"{header}\n0,1,2\n1,2,3\n", "has column 'u' more than once")


def test_a_name_that_polars_would_give_is_a_name(log):
    run = log("t,u_duplicated_0,u\n0,1,2\n1,2,3\n", {"columns": {"u_duplicated_0": "v"}})
    np.testing.assert_array_equal(run.channels["v"], [1, 2])


_NOON = datetime(2024, 5, 1, 12)
_TIMES = {
    "Duration": [timedelta(0), timedelta(seconds=0.25), timedelta(seconds=1)],
    "Datetime": [_NOON, _NOON + timedelta(seconds=0.25), _NOON + timedelta(seconds=1)],
    "Time": [time(12), time(12, 0, 0, 250_000), time(12, 0, 1)],
    "Decimal": [Decimal("0"), Decimal("0.25"), Decimal("1")],
    "Categorical": pl.Series(["0", "0.25", "1"], dtype=pl.Categorical),
    "text": ["0", "0.25", "1"],
}


@pytest.mark.parametrize("kind", _TIMES)
def test_every_kind_of_time_column_counts_seconds(tmp_path, kind):
    pl.DataFrame({"t": _TIMES[kind], "u": [1.0, 2.0, 3.0]}).write_parquet(tmp_path / "a.parquet")
    np.testing.assert_allclose(read_log(tmp_path / "a.parquet").t, [0, 0.25, 1], rtol=1e-15)


@pytest.mark.parametrize("unit", ["s", "iso"])
@pytest.mark.parametrize(
    "values",
    [
        [[1], [2]],
        [{"a": 1}, {"a": 2}],
        [b"1", b"2"],
        [True, False],
        [None, None],
        [date(1, 1, 1), date(1, 1, 1)],
        ["a", "b"],
        pl.Series(["a", "b"], dtype=pl.Categorical),
        pl.Series([1, 1], dtype=pl.UInt64),
    ],
)
def test_a_column_that_is_no_time_is_reported(tmp_path, unit, values):
    pl.DataFrame({"t": values, "u": [1.0, 2.0]}).write_parquet(tmp_path / "a.parquet")
    with pytest.raises(UndertowError, match=r"a.parquet") as caught:
        read_log(tmp_path / "a.parquet", LogMapping.model_validate({"time": {"unit": unit}}))
    assert "\n" not in str(caught.value)


_EPOCHS = {"ns": 1_714_564_800_123_456_789, "us": 1_714_564_800_123_456, "ms": 1_714_564_800_123}


@pytest.mark.parametrize("unit", _EPOCHS)
@pytest.mark.parametrize("kind", ["integer", "text", "datetime", "unsigned"])
def test_times_since_1970_are_subtracted_before_they_are_rounded(tmp_path, unit, kind):
    """Nanoseconds since 1970 as floats would be good to 256 ns."""
    steps = np.cumsum(np.random.default_rng(4).integers(1, 1000, 500))
    stamps = pl.Series("t", _EPOCHS[unit] + np.concatenate([[0], steps]))
    kinds = {"text": pl.String, "datetime": pl.Datetime(unit), "unsigned": pl.UInt64}
    column = stamps.cast(kinds.get(kind, pl.Int64))
    pl.DataFrame({"t": column, "u": np.arange(501.0)}).write_parquet(tmp_path / "a.parquet")
    run = read_log(tmp_path / "a.parquet", LogMapping.model_validate({"time": {"unit": unit}}))
    tick = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3}[unit]
    np.testing.assert_allclose(run.t[1:], steps * tick, rtol=1e-14)


@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
def test_times_since_1970_are_the_same_in_parts(tmp_path, name):
    stamps = _EPOCHS["ns"] + np.arange(0, 1000 * 333, 333)
    table = pl.DataFrame({"t": stamps, "u": np.arange(1000.0)})
    table.write_csv(tmp_path / name) if name.endswith("csv") else table.write_parquet(tmp_path / name)
    mapping = LogMapping.model_validate({"time": {"unit": "ns"}})
    whole = read_log(tmp_path / name, mapping)
    t = np.unique(np.concatenate([part.run.t for part in _parts(tmp_path / name, mapping)]))
    np.testing.assert_array_equal(t, whole.t)
    np.testing.assert_allclose(t, np.arange(1000) * 333e-9, rtol=1e-14)


def test_zeros_that_a_loss_of_power_leaves_behind_the_last_row_are_no_row(log):
    assert log("t,u\n0,1\n0.1,2\n0.2,3\n" + 40 * "\0").t[-1] == 0.2
    assert log("t,u\n0,1\n0.1,2\n0.2,3" + 40 * "\0").channels["u"][-1] == 3.0


def test_seconds_since_1970_in_text_keep_their_nanoseconds(log):
    run = log("t,u\n1714564800.123456789,1\n1714564800.123456999,2\n1.7145648005e9,3\n")
    np.testing.assert_allclose(run.t, [0, 210e-9, 0.376543211], rtol=1e-9)


def test_shares_of_full_thrust_that_are_taken_for_newtons_are_reported(tmp_path):
    otter = load_vehicle("otter")
    otter = replace(
        otter, thrusters=tuple(replace(t, thrust_per_command=Value(1.0)) for t in otter.thrusters)
    )
    path, full = tmp_path / "run.csv", LogMapping()
    names = [*otter.velocity_names, *otter.command_names]
    rows = np.column_stack([np.linspace(-1.0, 1.0, 50)] * len(names))
    table = pl.DataFrame(dict(zip(["t", *names], [np.arange(50.0), *rows.T], strict=True)))
    in_newtons = {n: {"channel": n, "unit": "N"} for n in otter.command_names}
    for by, mapping, reported in (
        (1.0, full, 1),
        (0.7, full, 0),
        (3.0, full, 0),
        (1.0, {"columns": in_newtons}, 0),
    ):
        table.with_columns(pl.col(n) * by for n in otter.command_names).write_csv(path)
        (run,) = read_logs([path], otter, LogMapping.model_validate(mapping))
        assert len([note for note in run.reader_notes if "takes them as newtons" in note]) == reported, (
            by,
            reported,
        )
    table.write_csv(path)
    for change in ({"limit": 1.0}, {"thrust_per_command": Value(1.0, estimate=True)}):
        other = replace(otter, thrusters=tuple(replace(t, **change) for t in otter.thrusters))
        (run,) = read_logs([path], other, LogMapping())
        assert not run.reader_notes
