"""The same numbers on a cluster of processes as in one, whatever dies on the way."""

from __future__ import annotations

import gc
import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.trust.cases import Planned
from benchmarks.trust.run import records, run
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.fleet.changes import FleetReport
from undertow.fleet.diagnose import Store, diagnose
from undertow.fleet.engine import DaskEngine, Failure, InProcess, Timeouts, engine
from undertow.fleet.reduction import Job
from undertow.fleet.rollouts import RolloutJob, rollouts


def question(fleet: Path) -> tuple[list[str], Job]:
    return [str(fleet / "logs/**/*.parquet")], Job(str(fleet / "craft.toml"), rows=300)


@pytest.fixture(scope="session")
def alone(fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> FleetReport:
    """The answer of the path without a cluster."""
    return diagnose(*question(fleet), InProcess(), Store(tmp_path_factory.mktemp("alone")))


def numbers(of: FleetReport) -> np.ndarray:
    periods = [p for v in of.vehicles for p in (*v.months, v.whole)]
    values = [[p.misfit, *(x for q in p.parameters for x in (q.value, q.error))] for p in periods]
    changes = [[x for c in p.changes for x in (c.percent, c.error, c.p_value)] for p in periods]
    return np.array([x for row in (*values, *changes) for x in row], dtype=float)


def test_one_process_names_what_fouls_and_nothing_else(alone: FleetReport) -> None:
    alfa, bravo = alone.vehicles
    assert (alfa.vehicle, bravo.vehicle) == ("alfa", "bravo")
    assert alfa.whole.statement.answer == "none seen"
    assert bravo.whole.statement.effects == ("fouling",)
    assert [p.name for p in bravo.months] == ["2026-01", "2026-02", "2026-03"]
    assert (alone.done, alone.worked, alone.failed) == (18, 18, {})


@pytest.mark.slow
def test_a_cluster_gives_the_same_though_a_worker_is_killed(
    fleet: Path, alone: FleetReport, cluster: DaskEngine, tmp_path: Path
) -> None:
    processes: dict[str, int] = cluster.client.run(os.getpid)
    assert len(set(processes.values())) == 2
    killed: list[int] = []

    def kill(done: float, words: str) -> None:
        if words.startswith("6 of 18"):
            killed.append(next(iter(processes.values())))
            os.kill(killed[0], signal.SIGKILL)

    found = diagnose(*question(fleet), cluster, Store(tmp_path), kill)
    assert killed
    assert (found.done, found.worked, found.failed) == (18, 18, {})
    np.testing.assert_allclose(numbers(found), numbers(alone), rtol=1e-10, atol=1e-12)
    assert [v.whole.statement for v in found.vehicles] == [v.whole.statement for v in alone.vehicles]


def _fatal(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 2:
        raise UndertowError("no such thing: take another")
    return number


def _may_die(times: int, dask_scheduler: Any = None) -> None:
    dask_scheduler.allowed_failures = times


@pytest.mark.slow
def test_what_kills_its_workers_is_given_up_and_the_rest_is_done(cluster: DaskEngine) -> None:
    cluster.client.run_on_scheduler(_may_die, 0)
    (_, killer), *more = cluster.results(_fatal, [(1,)])
    cluster.client.run_on_scheduler(_may_die, 3)
    assert isinstance(killer, Failure)
    assert "killed several workers" in killer.words
    assert not more
    rest = dict(cluster.results(_fatal, [(0,), (2,), (3,)]))
    assert rest == {0: 0, 1: Failure("no such thing: take another"), 2: 3}


def test_any_scheduler_will_do(cluster: DaskEngine) -> None:
    with engine(cluster.client.scheduler.address) as other:
        assert sorted(other.results(abs, [(-1,), (2,)])) == [(0, 1), (1, 2)]


def test_a_scheduler_that_is_not_there_is_refused(
    cluster: DaskEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("undertow.fleet.engine.TIMEOUTS", Timeouts(scheduler=0.2))
    with pytest.raises(UndertowError, match=r"127\.0\.0\.1:9' does not answer"), engine("tcp://127.0.0.1:9"):
        pass
    with pytest.raises(UndertowError, match="does not answer"), engine("nonsense://"):
        pass


def _page(dask_scheduler: Any = None) -> int:
    return dask_scheduler.http_server.port


@pytest.mark.slow
def test_a_second_cluster_of_this_machine_is_not_in_the_way(cluster: DaskEngine) -> None:
    """The page of the scheduler is at any port that is free, so that Dask has nothing to warn of."""
    assert cluster.client.run_on_scheduler(_page) != 8787
    with engine(workers=1) as other:
        assert list(other.results(abs, [(-1,)])) == [(0, 1)]


@pytest.mark.parametrize("address", first_quick(["nonsense", "nonsense:x", "", "tls://127.0.0.1:9"], 2))
def test_what_is_no_address_is_refused_once_and_for_all(
    address: str, cluster: DaskEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing of a client is left that complains when it is thrown away."""
    complaints: list[Any] = []
    monkeypatch.setattr("undertow.fleet.engine.TIMEOUTS", Timeouts(scheduler=0.1))
    monkeypatch.setattr("sys.unraisablehook", complaints.append)
    with pytest.raises(UndertowError, match="does not answer"), engine(address):
        pass
    gc.collect()
    assert not complaints


def _sockets(dask_worker: Any = None, dask_scheduler: Any = None) -> set[str]:
    """Addresses on which this process listens for connections, by the system itself."""
    process = pytest.importorskip("psutil").Process()
    return {c.laddr.ip for c in process.net_connections(kind="inet") if c.status == "LISTEN"}


def _listening(doing: DaskEngine) -> set[str]:
    """Addresses on which scheduler, page, nannies and workers listen."""
    client = doing.client
    workers, nannies = client.run(_sockets), client.run(_sockets, nanny=True)
    here = client.run_on_scheduler(_sockets)  # scheduler, its page and the nannies: this process
    assert workers
    return here.union(*workers.values(), *nannies.values())


def test_nobody_outside_this_machine_reaches_the_cluster(cluster: DaskEngine) -> None:
    """Dask runs whatever it is sent by anybody who can connect."""
    assert _listening(cluster) == {"127.0.0.1"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only on Linux every address of 127/8 is this machine")
def test_a_cluster_listens_elsewhere_only_where_it_is_told_to() -> None:
    pytest.importorskip("distributed", reason="Dask is not installed: pip install undertow[fleet]")
    with engine(workers=1, listen="127.0.0.2") as doing:
        assert doing.client.scheduler.address.startswith("tcp://127.0.0.2:")
        assert "127.0.0.2" in _listening(doing)
        assert _listening(doing) <= {"127.0.0.1", "127.0.0.2"}


@pytest.mark.parametrize("address", ["192.0.2.77", "no such place", "", "::1", "127.0.0.1:80", "é" * 300])
def test_an_address_that_this_machine_does_not_have_is_refused(address: str) -> None:
    with (
        pytest.raises(UndertowError, match=r"cannot listen on .*--listen"),
        engine(workers=1, listen=address),
    ):
        pass


@pytest.mark.parametrize(
    ("options", "why"), [({"workers": 0}, "--workers 0"), ({"scheduler": "x"}, "--sched")]
)
def test_to_listen_is_for_a_cluster_of_this_machine(options: dict[str, Any], why: str) -> None:
    with (
        pytest.raises(UndertowError, match=f"--listen 127.0.0.1 .*{why}"),
        engine(**options, listen="127.0.0.1"),
    ):
        pass


class _Future:
    def add_done_callback(self, tell: Any) -> None:
        pass


class _Deaf:
    """A cluster that never answers."""

    status = "running"

    def __init__(self, workers: int) -> None:
        self._workers, self.cancelled = workers, 0

    @property
    def scheduler(self) -> SimpleNamespace:
        return SimpleNamespace(ncores=None)

    def sync(self, function: Any, callback_timeout: float) -> dict[str, int]:
        return dict.fromkeys(map(str, range(self._workers)), 1)

    def submit(self, function: Any, *arguments: Any, **options: Any) -> object:
        return _Future()

    def cancel(self, futures: list[Any], force: bool) -> None:
        self.cancelled += 1


@pytest.mark.parametrize(("workers", "words"), [(2, "no answer of any worker"), (0, "no worker")])
def test_silence_comes_to_an_end(workers: int, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("undertow.fleet.engine.TIMEOUTS", Timeouts(poll=0.01, workerless=0.05))
    client = _Deaf(workers)
    found = dict(DaskEngine(client, patience=0.1).results(abs, [(1,), (2,)]))
    assert all(words in failure.words for failure in found.values())
    assert sorted(found) == [0, 1]
    assert client.cancelled == 1


def test_one_bad_item_stops_no_other() -> None:
    found = dict(InProcess().results(_half, [(4,), ("x",)]))
    assert found[0] == 2
    assert "TypeError" in found[1].words


def _half(number: Any) -> Any:
    return number / 2


@pytest.mark.slow
def test_rollouts_on_a_cluster_are_those_of_one_process(fleet: Path, cluster: DaskEngine) -> None:
    logs = [str(next((fleet / "logs").rglob("*.parquet")))]
    job = RolloutJob(str(fleet / "craft.toml"), horizon=10.0)
    here, there = (rollouts(job, logs, 20, doing)[0] for doing in (InProcess(), cluster))
    assert [b.window for b in there] == [0, 1, 2, 3, 4]
    for one, other in zip(here, there, strict=True):
        np.testing.assert_allclose(one.high, other.high, rtol=1e-10)
        np.testing.assert_allclose(one.low, other.low, rtol=1e-10)


def _record(case: Planned) -> dict[str, Any]:
    if case.seed == 3:
        raise ValueError("no such case")
    return {"id": case.id, "kind": case.kind, "where": os.getpid()}


def test_the_benchmark_of_trust_runs_on_a_cluster(cluster: DaskEngine, tmp_path: Path) -> None:
    cases = [Planned("usv", (), 1.0, 1.0, False, "plain", seed) for seed in range(4)]
    out = tmp_path / "trust.jsonl"
    assert run(cases, out, _record, engine=cluster) == 1
    found = {r["id"]: r for r in records(out)}
    assert set(found) == {c.id for c in cases}
    assert found[cases[3].id]["failure"] == "ValueError: no such case"
    assert found[cases[0].id]["where"] != os.getpid()
    assert run(cases, out, _record, engine=cluster) == 0
    late = [Planned("usv", (), 1.0, 1.0, False, "plain", 9)]
    assert run(late, out, _record, engine=cluster, minutes=-1.0) == 0
    assert len(records(out)) == 4
