"""A steady force and one that begins in the course of a run: only the first has the same size throughout."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.identification.logs_of import prepared
from tests.identification.surge import TRUTH, surge_run, true_surge
from tests.quick import first_quick
from undertow.identification.diagnosis.bench import open_bench
from undertow.identification.diagnosis.consistency import (
    constant_heading,
    sizes_by_part,
    step_wider_than_motion,
)
from undertow.identification.diagnosis.rounds import try_all
from undertow.identification.diagnosis.settings import DEFAULT
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue

FORCE, BEGIN = 0.1, 8.0


def _doubts(begin: float, seed: int) -> dict[str, str]:
    """What parts of the logs say of a constant force where the logged force lacks 0.1 N from some time on."""
    runs = []
    for number in (seed, seed + 100):
        run = surge_run(0.01, number)
        logged = run.channels["tau_X"] - np.where(run.t >= begin, FORCE, 0.0)
        runs.append(Run("P", run.t, run.channels | {"tau_X": logged}, sha256=f"{number}"))
    vehicle = true_surge()
    vehicle = vehicle.with_values({n: replace(vehicle.value_of(n), estimate=False) for n in TRUTH})
    bench = open_bench(vehicle, *prepared(vehicle, runs[:1], runs[1:]))
    constant = {"constant_force": catalogue()["constant_force"]}
    current = try_all(bench.without_disturbance(), constant, lambda done, words: None)
    return {a.division: a.doubt(DEFAULT) for a in sizes_by_part(current.findings[0], current.bench)}


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_a_steady_force_has_one_size(seed: int) -> None:
    assert not any(_doubts(0.0, seed).values())


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_a_force_that_begins_later_has_none_before(seed: int) -> None:
    said = _doubts(BEGIN, seed)["parts of a run"]
    assert said.startswith("its size would have to vary from ")


@pytest.mark.parametrize(("rate", "words"), [(0.01, ""), (0.039, "friction_rate = 0.039 rad/s exceeds")])
def test_friction_that_is_not_there_at_the_speeds_of_the_log_is_none(rate: float, words: str) -> None:
    """Turning rates of 0.025 rad/s rms, as in zigzags of a tanker, beside speeds of 1 m/s."""
    t = np.linspace(0.0, 60.0, 601)
    motion = np.column_stack([t, t, np.ones_like(t), 0.025 * np.sqrt(2.0) * np.sin(t)])
    fit = SimpleNamespace(
        values={"friction_speed": 0.02, "friction_rate": rate}, model=SimpleNamespace(free=("friction_rate",))
    )
    candidate = SimpleNamespace(parameters=catalogue()["dry_friction"](()).parameters)
    finding = SimpleNamespace(trial=SimpleNamespace(fit=fit, candidate=candidate))
    data = SimpleNamespace(names=("x", "psi", "u", "r"), segments=[SimpleNamespace(measured=motion)])
    said = step_wider_than_motion(finding, SimpleNamespace(train=data))  # type: ignore[arg-type]
    assert said.startswith(words)
    assert bool(said) == bool(words)


@pytest.mark.parametrize(("free", "told"), [(("V_N",), True), (("V_N@a", "V_N@b"), False)])
def test_a_current_of_each_run_needs_a_run_that_turns(free: tuple[str, ...], *, told: bool) -> None:
    """Two straight runs, on two headings: a current that both share shows, one of each is any force."""
    t = np.arange(0.0, 60.0, 0.1)
    runs = [Run(name, t, {"psi": at + 0.01 * np.sin(t)}) for name, at in (("a", 0.3), ("b", 2.1))]
    model = SimpleNamespace(free=free)
    effect = SimpleNamespace(effect=catalogue()["ocean_current"])
    trial = SimpleNamespace(candidate=effect, fit=SimpleNamespace(model=model))
    finding = SimpleNamespace(of_sensors=False, trial=trial)
    data = (SimpleNamespace(runs=runs[:1]), SimpleNamespace(runs=runs[1:]))
    bench = SimpleNamespace(train=data[0], test=data[1], settings=DEFAULT)
    assert (constant_heading(finding, bench) == "") is told  # type: ignore[arg-type]
