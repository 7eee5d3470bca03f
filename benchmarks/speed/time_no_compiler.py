"""Simulation without a C compiler: instructions as data, and CasADi's virtual machine, beside C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from undertow.codegen import Simulator
from undertow.control.closed_loop import ClosedLoop, Scenario
from undertow.control.gains import GainSet, load_gains
from undertow.model.loading import load_vehicle

from . import vehicle
from .conftest import Speed

SAMPLES, FEW, RUNS, DIFFERENTIATED = 400, 50, 200, 20
COMPILED, VIRTUAL = "undertow, C", "undertow, CasADi's virtual machine"
UNCOMPILED = "undertow, instructions run by C"
LIMIT = 1e-12


@dataclass(frozen=True)
class Work:
    """One run, or many of different vehicles, with sensitivities or without; times are those of a step."""

    what: str
    runs: int = 1
    columns: int = 0

    def done(self, who: str, samples: int) -> np.ndarray:
        """States, or sensitivities, at the last sample."""
        simulator = _simulator(who)
        t, commands = 0.05 * np.arange(samples + 1, dtype=float), 0.1 * vehicle.commands(1)
        u = np.repeat(commands, samples + 1, 0)
        x0, p = np.zeros(len(vehicle.functions().state_names)), np.array(vehicle.functions().values())
        if self.columns:
            return simulator.run_with_sensitivities(x0, t, u, p, range(self.columns))[1][-1]
        if self.runs > 1:
            scales = np.random.default_rng(0).uniform(0.9, 1.1, (self.runs, 1))
            return simulator.run(np.repeat(x0[None], self.runs, 0), t, u, scales * p)[:, -1]
        return simulator.run(x0, t, u, p)[-1]


WORK = (
    Work("no C compiler: a step of a simulation"),
    Work(f"no C compiler: a step with {DIFFERENTIATED} sensitivities", columns=DIFFERENTIATED),
    Work(f"no C compiler: a step of each of {RUNS} simulations", runs=RUNS),
)


@cache
def _simulator(who: str) -> Simulator:
    return Simulator(vehicle.functions(), compiled=who == COMPILED)


@pytest.mark.parametrize("who", [COMPILED, UNCOMPILED, VIRTUAL])
@pytest.mark.parametrize("work", WORK, ids=lambda w: w.what)
def time_a_step(speed: Speed, work: Work, who: str, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = SAMPLES if work.runs == 1 else FEW
    expected = work.done(COMPILED, samples)
    if who == VIRTUAL:
        monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")
    apart = float(np.abs(work.done(who, samples) - expected).max() / np.abs(expected).max())
    calls = samples * work.runs
    speed(work.what, who, lambda: work.done(who, samples), calls=calls, apart=apart, limit=LIMIT, rounds=5)


@pytest.mark.parametrize("who", [COMPILED, VIRTUAL])
def time_a_sample_of_a_closed_loop(speed: Speed, who: str) -> None:
    loop, samples = ClosedLoop(_gains(), compiled=who == COMPILED), 10 * SAMPLES
    scenario = Scenario((1.0, 1.0, 1.0, 0.5), samples * 0.001, 0.001)
    expected = _ends(ClosedLoop(_gains(), compiled=True).run(scenario).state)
    apart = float(np.abs(_ends(loop.run(scenario).state) - expected).max())
    what = "no C compiler: a sample of a closed loop, PID on the mini-AUV"
    speed(what, who, lambda: loop.run(scenario), calls=samples, apart=apart, limit=LIMIT, rounds=5)


def _gains() -> GainSet:
    return load_gains("paper-pid", load_vehicle("mini-auv"))


def _ends(state: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.array([values[-1] for values in state.values()])
