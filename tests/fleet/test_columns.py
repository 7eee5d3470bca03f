"""What a partition is reduced to, against plain least squares and against each effect by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from benchmarks.fleet.made import fouling, run
from undertow.errors import UndertowError
from undertow.fleet.changes import Prior, days_of, selection, solve
from undertow.fleet.reduction import Job, Panel, reduce_log, reduce_runs, runs_of, with_fingerprint
from undertow.identification.diagnosis.candidates import candidates
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.residual import whitened
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle


@pytest.fixture(scope="module")
def panel(fleet: Path) -> Panel:
    return with_fingerprint(Job(str(fleet / "craft.toml")))[1]


@pytest.fixture(scope="module")
def day(fleet: Path) -> Run:
    return run(fleet / "craft.toml", fouling(0.1), np.random.default_rng(3))


def test_columns_together_are_those_of_each_effect_by_itself(panel: Panel, day: Run) -> None:
    together = panel.table(day)
    data = prepare([day], panel.vehicle)
    p = np.array(panel.base.functions.values(), dtype=float)
    noise = panel._noise(data, p)  # private: both sides are to be weighed alike
    order = [*panel.daily, *panel.names]
    known = {c.id: c for c in candidates(panel.vehicle, catalogue())}
    for effect in ("thruster_gain", "ocean_current", "sensor_scale", "lift", "thruster_curve"):
        names = tuple(q.name for q in known[effect].parameters)
        model = known[effect].model(names)
        own = whitened(model.linearise(data, np.array(model.functions.values(), dtype=float)), noise)
        places = [order.index(n) for n in names]
        np.testing.assert_allclose(together.J[:, places], own.J, rtol=1e-8, atol=1e-8 * np.abs(own.J).max())


def test_the_factor_is_least_squares_over_all_rows(panel: Panel, day: Run) -> None:
    """Parts, projection of what differs from day to day, and the sum over days change no estimate."""
    halves = [day.slice(None, 24.0), day.slice(24.1, None)]
    reduced = reduce_runs(halves, panel, "day")
    found = solve(
        days_of([(np.datetime64("2026-01-01").item(), reduced)]),
        [selection(panel.names, panel.free)],
        Prior().beside(len(panel.free)),
    )
    rows = [panel.table(half) for half in halves]
    J, r = np.vstack([t.J for t in rows]), np.concatenate([t.r for t in rows])
    chosen = [*range(len(panel.daily)), *(len(panel.daily) + panel.names.index(n) for n in panel.free)]
    plain = np.linalg.lstsq(J[:, chosen], -r, rcond=None)[0][len(panel.daily) :]
    np.testing.assert_allclose(found.theta, plain, rtol=1e-8)
    assert reduced.entries == len(r)
    assert reduced.samples == len(day.t)
    # The errors by the noise alone are those of the rows, too.
    inverse = np.linalg.inv(J[:, chosen].T @ J[:, chosen])
    size = np.sqrt(np.diag(inverse)[len(panel.daily) :])
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), size, rtol=1e-6)


def test_one_linear_step_agrees_with_a_fit(panel: Panel, fleet: Path, day: Run) -> None:
    vehicle = load_vehicle(fleet / "craft.toml").with_effect(catalogue()["ocean_current"], {})
    fit = fit_weak(vehicle, prepare([day], vehicle), (*panel.free, "V_N", "V_E"))
    only_current = Panel(panel.vehicle, catalogue(), ["ocean_current"])
    reduced = reduce_runs([day], only_current, "day")
    found = solve(
        days_of([(np.datetime64("2026-01-01").item(), reduced)]),
        [selection(only_current.names, panel.free)],
        Prior().beside(len(panel.free)),
    )
    for name, step, error in zip(panel.free, found.theta, found.errors, strict=True):
        assert panel.vehicle.value_of(name).value + step == pytest.approx(fit.values[name], abs=1.5 * error)


def test_thinned_rows_dates_and_reports_now_and_then_count_as_in_any_log(
    panel: Panel, fleet: Path, tmp_path: Path
) -> None:
    rows = pl.read_parquet(next((fleet / "logs").rglob("*.parquet"))).head(600)
    number = pl.int_range(pl.len())
    now_and_then = pl.when(number % 3 == 0).then(pl.col("u"))
    kept = rows.with_columns(now_and_then.forward_fill(), new=(number % 3 == 0).cast(pl.Int8))
    dated = pl.datetime(2026, 2, 3) + pl.duration(microseconds=1e6 * pl.col("t"))
    numbered = rows.with_columns(leg=pl.when(number != 300).then(number // 301))
    fresh = {"columns": {"u": {"channel": "u", "fresh": "new"}}}
    in_words = rows.with_columns(dated.dt.to_string("%FT%T%.6f").alias("t"))
    cases = (
        ([rows.gather_every(2)], rows, {"time": {"every": 2}}),
        ([rows.with_columns(now_and_then)], kept, {**fresh, "ignore": ["new"]}),
        ([rows], in_words, {"time": {"unit": "iso"}}),
        ([rows.head(300), rows.slice(301)], numbered, {"time": {"stretch": "leg"}}),
    )

    def read(table: pl.DataFrame, mapping: dict[str, object]) -> Iterator[Run]:
        table.write_parquet(tmp_path / "log.parquet")
        job = Job("", mapping=LogMapping.model_validate(mapping).model_dump_json())
        return runs_of(job, str(tmp_path / "log.parquet"), panel.vehicle.command_names)

    for plain, table, mapping in cases:
        wanted = reduce_runs([run for one in plain for run in read(one, {})], panel, "log").factor
        found = reduce_runs(read(table, mapping), panel, "log").factor
        size = np.linalg.norm(wanted, axis=0)
        np.testing.assert_allclose(found.T @ found, wanted.T @ wanted, atol=1e-5 * np.outer(size, size).max())


def test_a_vehicle_with_nothing_to_estimate_is_refused(fleet: Path, tmp_path: Path) -> None:
    known = tmp_path / "known.toml"
    known.write_text((fleet / "craft.toml").read_text().replace("estimate = true", "estimate = false"))
    with pytest.raises(UndertowError, match="no parameter of 'craft' is marked for estimation"):
        with_fingerprint(Job(str(known)))
    with pytest.raises(UndertowError, match="'currant' is not an effect"):
        with_fingerprint(Job(str(fleet / "craft.toml"), daily=("currant",)))


@pytest.mark.slow
def test_a_worker_with_another_vehicle_file_refuses(fleet: Path, tmp_path: Path) -> None:
    job = with_fingerprint(Job(str(fleet / "craft.toml")))[0]
    other = tmp_path / "craft.toml"
    other.write_text((fleet / "craft.toml").read_text().replace("20.0", "21.0"))
    elsewhere = Job(str(other), fingerprint="0" * 64)
    with pytest.raises(UndertowError, match="reads a different"):
        reduce_log(elsewhere, str(next((fleet / "logs").rglob("*.parquet"))))
    assert with_fingerprint(Job(str(other)))[0].fingerprint != job.fingerprint
