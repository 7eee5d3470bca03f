"""Work on several processes: the same results in the same order, whatever happens to a process."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import undertow as ut
from benchmarks.hidden_effects import make_case, write_case
from tests.identification.logs_of import runs_of, vehicle_of
from undertow.errors import UndertowError
from undertow.identification.api import try_effect
from undertow.identification.comparison import compare
from undertow.identification.diagnose import diagnose
from undertow.identification.diagnosis.parallel import in_background, jobs, mapped
from undertow.identification.diagnosis.validation import SimulationValidator
from undertow.identification.doctor.examine import examine
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.output_error import OutputErrorFit, fit_output_error
from undertow.identification.estimation.prediction_error import (
    fit_prediction_error,
    refit_by_prediction_error,
)
from undertow.identification.estimation.weak_form import fit_instrumental, fit_weak, free_parameters
from undertow.identification.logs.reading import read_log
from undertow.identification.observe import observe
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle

shared_memory = pytest.mark.skipif(sys.platform != "linux", reason="processes share memory on Linux only")


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERTOW_JOBS", "2")


@shared_memory
def test_results_come_in_order_from_other_processes(two: None) -> None:
    found = list(mapped(lambda i: (i * i, os.getpid(), jobs()), 20))
    assert [square for square, _, _ in found] == [i * i for i in range(20)]
    assert os.getpid() not in {pid for _, pid, _ in found}
    assert {inner for _, _, inner in found} == {1}


def test_one_job_is_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERTOW_JOBS", "1")
    assert list(mapped(lambda i: os.getpid(), 3)) == [os.getpid()] * 3
    with in_background(os.getpid) as found:
        assert found() == os.getpid()


def test_the_linear_algebra_has_one_thread_in_long_work(tmp_path: Path) -> None:
    write_case(make_case("box", ("quadratic_damping",), 7, duration=20.0), tmp_path)
    model = load_vehicle(tmp_path / "vehicle.toml")
    run = read_log(tmp_path / "train_1.csv", channels=model.command_names)
    seen: dict[str, list[int]] = {"fit": [], "add": []}
    with threadpool_limits(2):
        ut.fit(model, [run], report=lambda *_: seen["fit"].extend(blas_threads()))
        try_effect(model, "quadratic_damping", [run], report=lambda *_: seen["add"].extend(blas_threads()))
        assert set(blas_threads()) == {2}
    assert set(seen["fit"]) == set(seen["add"]) == {1}


class Watched(list[Any]):
    """Logs that note in how many threads the linear algebra is when they are read."""

    def __iter__(self) -> Iterator[Any]:
        seen.update(blas_threads())
        return super().__iter__()


seen: set[int] = set()


def test_every_function_that_estimates_has_the_linear_algebra_in_one_thread(tmp_path: Path) -> None:
    write_case(make_case("box", ("quadratic_damping",), 7, duration=20.0), tmp_path)
    model = load_vehicle(tmp_path / "vehicle.toml")
    run = read_log(tmp_path / "train_1.csv", channels=model.command_names)
    weak = fit_weak(model, prepare([run], model), free_parameters(model))
    estimating: dict[str, Callable[[Watched], object]] = {
        "prepare": lambda runs: prepare(runs, model),
        "compare": lambda runs: compare(model, runs, compiled=False),
        "examine": lambda runs: examine(model, runs),
        "observe": lambda runs: observe(model, run, progress=lambda *_: seen.update(blas_threads())),
        "fit_output_error": lambda runs: fit_output_error(model, runs, None, 5.0),
        "fit_instrumental": lambda runs: fit_instrumental(model, runs, None, 5.0),
        "fit_prediction_error": lambda runs: fit_prediction_error(model, runs),
        "refit_by_prediction_error": lambda runs: refit_by_prediction_error(weak, runs),
    }
    for name, estimate in estimating.items():
        seen.clear()
        with threadpool_limits(2):
            estimate(Watched([run]))
            assert set(blas_threads()) == {2}, name
        assert seen == {1}, name


def blas_threads() -> list[int]:
    """Threads of every library of linear algebra that is loaded."""
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


@shared_memory
def test_a_killed_process_costs_no_result(two: None, caplog: pytest.LogCaptureFixture) -> None:
    parent = os.getpid()

    def work(i: int) -> int:
        if i == 3 and os.getpid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return 10 * i

    assert list(mapped(work, 6)) == [0, 10, 20, 30, 40, 50]
    assert "a worker process was killed" in caplog.text


@shared_memory
def test_an_error_is_the_error_of_the_work(two: None) -> None:
    def work(i: int) -> int:
        raise UndertowError(f"no {i}")

    with pytest.raises(UndertowError, match="no 0"):
        list(mapped(work, 2))
    with in_background(lambda: work(7)) as found, pytest.raises(UndertowError, match="no 7"):
        found()


@shared_memory
def test_something_is_done_aside_while_other_work_uses_all_cores(two: None) -> None:
    with in_background(os.getpid) as found:
        others = set(mapped(lambda i: os.getpid(), 4))
        assert found() not in {os.getpid(), *others}


@shared_memory
def test_a_diagnosis_does_not_depend_on_the_number_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_case(make_case("box", ("quadratic_damping",), 7, duration=20.0), tmp_path)
    model = load_vehicle(tmp_path / "vehicle.toml")
    runs = [read_log(tmp_path / f"{n}.csv", channels=model.command_names) for n in ("train_1", "holdout")]
    known, answers = {i: catalogue()[i] for i in ("quadratic_damping", "constant_force")}, []
    threads: set[int] = set()
    for number in ("1", "2"):
        monkeypatch.setenv("UNDERTOW_JOBS", number)
        with threadpool_limits(2):
            result = diagnose(
                model, runs[:1], runs[1:], known=known, report=lambda *_: threads.update(blas_threads())
            )
        answers.append(result.diagnosis.model_dump(exclude={"seconds"}))
    assert threads == {1}
    assert answers[0] == answers[1]
    assert answers[0]["effects"] == ["quadratic_damping"]


@shared_memory
def test_final_fits_of_other_processes_are_those_of_this_one(
    two: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = make_case("box", ("thruster_lag",), 4, duration=30.0)
    vehicle, (*train, test) = vehicle_of(case), runs_of(case)
    data, heard = prepare(train, vehicle), list[tuple[int, int]]()
    weak = [fit_weak(vehicle, data, names) for names in (None, free_parameters(vehicle)[:-1])]
    there, here = (SimulationValidator(vehicle, train, [test], data.sigma) for _ in range(2))
    there.compute_final_fits(weak, lambda *done: heard.append(done))
    assert heard == [(1, 2), (2, 2)]
    with monkeypatch.context() as context:  # none is made again
        context.setattr("undertow.identification.diagnosis.validation.final_fit", None)
        sent = [there.final(w) for w in weak]
    for fit, begun in zip(sent, weak, strict=True):
        own = here.final(begun)
        assert isinstance(fit, OutputErrorFit)
        assert fit.model is begun.model
        np.testing.assert_array_equal(fit.p, own.p)
        np.testing.assert_array_equal(there.squares(fit), here.squares(own))
        np.testing.assert_array_equal(fit.covariance, own.covariance)
        for horizon, ahead in here.squares_ahead(own).items():
            np.testing.assert_array_equal(there.squares_ahead(fit)[horizon], ahead)
