"""Sensors slower than their log, and commands in a unit whose square is the thrust."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.integrate import solve_ivp

from tests.identification.surge import M_X, TRUTH, surge_vehicle
from undertow.errors import UndertowError
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.mapping import LogMapping, read_mapping
from undertow.identification.logs.opening import save_log
from undertow.identification.logs.reading import read_log, stated_disturbance

RATE, PERIOD = 6.0, 1.0  # rows a second; seconds between reports


@pytest.fixture
def slow_log(tmp_path):
    """A log of 60 s whose velocity repeats a report of each second; `true` is what it reports."""
    t = np.arange(0.0, 60.0, 1 / RATE)
    reported = PERIOD * np.floor(t / PERIOD + 1e-9)
    new = np.isclose(t, reported)
    noise = np.random.default_rng(5).normal(0.0, 0.01, 60)
    u = np.sin(0.3 * reported) + noise[reported.astype(int)]
    rows = "\n".join(f"{a:.6f},{b:.6f},{int(c)}" for a, b, c in zip(t, u, new, strict=True))
    path = tmp_path / "slow.csv"
    path.write_text("t,dvl,new\n" + rows + "\n")
    return path, t, np.sin(0.3 * t)


def mapping(**column):
    return LogMapping.model_validate({"columns": {"dvl": {"channel": "u", "fresh": "new", **column}}})


def test_rows_between_reports_are_not_late(slow_log):
    path, t, true = slow_log
    held = read_log(path, LogMapping.model_validate({"columns": {"dvl": "u"}, "ignore": ["new"]}))
    run = read_log(path, mapping())
    inside = np.isfinite(run.channels["u"])
    assert inside.sum() == len(t) - 5  # the rows after the last report
    error = np.std(run.channels["u"][inside] - true[inside])
    assert error < 0.012
    assert np.std(held.channels["u"] - true) > 8 * error


def test_the_noise_is_that_of_a_report(slow_log):
    run = read_log(slow_log[0], mapping())
    assert run.sigma["u"] == pytest.approx(0.01, rel=0.35)
    assert run.rows_per_report("u") == RATE * PERIOD
    assert any("60 reports in 360 rows" in note for note in run.notes)


def test_a_gap_without_reports_stays_a_gap(slow_log):
    path, t, _ = slow_log
    lines = path.read_text().splitlines()
    silent = [
        line if not 20 <= float(line.split(",")[0]) < 28 else line.rsplit(",", 1)[0] + ",0"
        for line in lines[1:]
    ]
    path.write_text("\n".join([lines[0], *silent]) + "\n")
    u = read_log(path, mapping()).channels["u"]
    lost = (t > 19.1) & (t < 27.9)
    assert np.isnan(u[lost]).all()
    assert np.isfinite(u[~lost & (t < 59)]).all()


def test_a_slow_channel_with_hardly_a_report_is_refused(slow_log):
    with pytest.raises(UndertowError, match="has 3 new reports, at least 10 are needed"):
        read_log(slow_log[0], mapping(), window=(0.0, 2.5))


def test_a_flag_that_is_not_there_is_named(slow_log):
    with pytest.raises(UndertowError, match="no column, named as `fresh` of 'dvl', 'news'"):
        read_log(slow_log[0], mapping(fresh="news"))


def test_rpm_become_newton_with_their_sign(tmp_path):
    path = tmp_path / "rpm.csv"
    path.write_text("t,u,n\n0,0.1,-1000\n1,0.2,0\n2,0.3,500\n")
    columns = {"n": {"channel": "stern", "scale": 3e-4, "power": 2}}
    run = read_log(path, LogMapping.model_validate({"columns": columns}), ["stern"])
    np.testing.assert_allclose(run.channels["stern"], [-300.0, 0.0, 75.0])
    assert any("stern = 0.0003 n |n|" in note for note in run.notes)


def test_without_a_flag_a_value_that_changes_is_new(slow_log):
    flagged, itself = (read_log(slow_log[0], mapping(fresh=f)) for f in ("new", "dvl"))
    np.testing.assert_array_equal(itself.channels["u"], flagged.channels["u"])


def test_a_saved_log_reads_back_with_its_reports_and_the_noise_that_was_stated(tmp_path: Path) -> None:
    t = np.arange(400) / 20
    table = {
        "t": t,
        "heading": np.degrees(np.sin(t)),
        "u": np.where(np.arange(400) % 5 == 0, np.cos(t), np.nan),
    }
    pl.DataFrame({**table, "f1": np.ones(400)}, nan_to_null=True).write_csv(tmp_path / "log.csv")
    mapping = LogMapping.model_validate(
        {
            "columns": {"heading": {"channel": "psi", "unit": "deg", "noise": "0.2 deg"}},
            "disturbance": {"X": "2 N"},
        }
    )
    run = read_log(tmp_path / "log.csv", mapping, ["f1"])
    beside = save_log(run.slice(2.0, 12.0), tmp_path / "part.csv")
    assert beside == tmp_path / "part.toml"
    again = read_log(tmp_path / "part.csv", read_mapping(beside), ["f1"])
    assert again.sigma["psi"] == pytest.approx(np.radians(0.2))
    assert stated_disturbance(again.mapping) == {"X": 2.0}
    assert np.array_equal(again.reports("u"), run.slice(2.0, 12.0).reports("u"), equal_nan=True)
    assert np.count_nonzero(np.isfinite(again.reports("u"))) == 41
    assert save_log(read_log(tmp_path / "log.csv"), tmp_path / "plain.csv") is None
    assert not (tmp_path / "plain.toml").exists()


# --- the position of an actuator, which moves on between samples -------------------------------------
SLOW = 0.4  # rad/s, of a force that is logged once a second


@pytest.fixture(scope="module")
def moving_force(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The surge experiment with a force 0.4 sin(0.4 t) N: velocity and force once a second, for 100 s."""

    def rates(t: float, u: np.ndarray) -> np.ndarray:
        drag = TRUTH["X_u"] * u + TRUTH["X_uabsu"] * np.abs(u) * u
        return np.asarray((0.4 * np.sin(SLOW * t) - drag) / M_X)

    t = np.arange(0.0, 101.0)
    u = solve_ivp(rates, (0.0, 100.0), [0.0], t_eval=t, rtol=1e-10, atol=1e-12).y[0]
    path = tmp_path_factory.mktemp("moving") / "surge.csv"
    pl.DataFrame({"t": t, "u": u, "force": 0.4 * np.sin(SLOW * t)}).write_csv(path)
    return path


def _drag(path: Path, **column: object) -> float:
    """Drag at 0.1 m/s, in units of the true one."""
    mapping = LogMapping.model_validate({"columns": {"u": "u", "force": {"channel": "tau_X", **column}}})
    vehicle = surge_vehicle()
    run = read_log(path, mapping, ["tau_X"])
    found, true = fit_weak(vehicle, prepare([run], vehicle)).values, TRUTH
    return -(found["X_u"] + 0.1 * found["X_uabsu"]) / (true["X_u"] + 0.1 * true["X_uabsu"])


def test_a_force_that_moves_between_samples_gives_the_drag_only_if_the_mapping_says_so(
    moving_force: Path,
) -> None:
    assert _drag(moving_force, interpolate=True) == pytest.approx(1.0, abs=0.02)  # (0.4)^2 / 12 is lost
    assert abs(_drag(moving_force) - 1.0) > 0.2


def test_rows_between_the_samples_of_an_actuator_have_the_mean_of_the_line(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.25)
    angle = np.where(np.arange(len(t)) % 4 == 0, 2.0 * t, np.nan)
    table = pl.DataFrame({"t": t, "u": np.sin(t), "angle": angle}, nan_to_null=True)
    table.write_csv(tmp_path / "log.csv")
    columns = {"u": "u", "angle": {"channel": "rudder", "interpolate": True}}
    mapping = LogMapping.model_validate({"columns": columns, "missing_commands": "hold"})
    run = read_log(tmp_path / "log.csv", mapping, ["rudder"])
    np.testing.assert_allclose(run.channels["rudder"][:230], 2.0 * (run.t[:230] + 0.125), rtol=1e-12)


def test_a_motion_is_never_held_so_that_it_cannot_be_said_to_be_interpolated(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,u\n0,1\n1,2\n2,3\n")
    mapping = LogMapping.model_validate({"columns": {"u": {"channel": "u", "interpolate": True}}})
    with pytest.raises(UndertowError, match=r"u is a motion of the vehicle.*remove it"):
        read_log(tmp_path / "log.csv", mapping)
