"""What many runs of a closed loop cost that differ in the vehicle's mass: 2 s at 1 ms each."""

from __future__ import annotations

import numpy as np
import pytest

from undertow.codegen.engine import processors

from . import loops
from .conftest import Speed
from .goals import BATCH

RUNS, DURATION, LIMIT = 1000, 2.0, 1e-10
PART = 100
SAMPLES = round(DURATION / loops.DT) + 1
ROUNDS = 15
THREADS = {"one thread": 1, "two threads": 2}
# All of a batch are run for two seconds; what ten seconds come to is checked on these.
CHECKED, CHECKED_FOR = 20, 10.0


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory) -> loops.HandLoop:
    return loops.HandLoop(tmp_path_factory.mktemp("hand"))


@pytest.fixture(scope="module")
def apart(by_hand: loops.HandLoop) -> float:
    """Largest distance of ours from those by hand."""
    masses = loops.masses(CHECKED)
    ours = loops.loop().run_many(loops.scenario(CHECKED_FOR), parameters={"m": masses}).states
    return float(np.abs(ours - by_hand.run(CHECKED_FOR, masses)).max())


@pytest.mark.parametrize("threads", THREADS)
def time_ours(speed: Speed, threads: str, apart: float) -> None:
    loop, scenario, masses = loops.loop(), loops.scenario(DURATION), loops.masses(RUNS)
    speed(
        BATCH,
        f"undertow, {threads}",
        lambda: loop.run_many(scenario, parameters={"m": masses}, threads=THREADS[threads]),
        apart=apart,
        limit=LIMIT,
        rounds=ROUNDS,
        more={"lanes": loop.stepper.lanes},
    )


@pytest.mark.parametrize("threads", THREADS)
def time_hand(speed: Speed, threads: str, by_hand: loops.HandLoop) -> None:
    """A part of the runs, so that a round takes about as long as one of ours: one run is like the other."""
    p = np.array([loops.hand_parameters(m) for m in loops.masses(PART)])
    log = np.empty((PART, (SAMPLES - 1) // loops.STRIDE + 1, 12))
    openmp = " (OpenMP)" if THREADS[threads] > 1 else ""
    speed(
        BATCH,
        f"hand-written C, {threads}{openmp}",
        lambda: by_hand.rerun(p, SAMPLES, log, THREADS[threads]),
        calls=PART / RUNS,
        rounds=3 * ROUNDS,
        more={"scaled_up_from": f"{PART} runs"},
    )


@pytest.mark.parametrize("runs", [1, 10, 100, 1000, 10_000])
@pytest.mark.parametrize("threads", [1, 2])
def time_growth(speed: Speed, runs: int, threads: int) -> None:
    loop, scenario, masses = loops.loop(), loops.scenario(DURATION), {"m": loops.masses(runs)}
    speed(
        f"so many rollouts of 2 s at 1 ms, {processors()} processors",
        f"undertow, {threads} thread{'s' if threads > 1 else ''}",
        lambda: loop.run_many(scenario, parameters=masses, threads=threads),
        size=runs,
        rounds=3 if runs < 10_000 else 2,
    )


@pytest.mark.parametrize("threads", [1, 2])
def time_open_loop(speed: Speed, threads: int) -> None:
    """Held commands instead of a controller."""
    from undertow.codegen import Simulator

    from . import vehicle

    functions = vehicle.functions()
    simulator = Simulator(functions, compiled=True)
    p = np.tile(functions.values(), (RUNS, 1))
    p[:, functions.parameter_names.index("m")] = loops.masses(RUNS)
    t = np.linspace(0, DURATION, 51)
    u, x0 = np.tile(vehicle.commands(1), (51, 1)), np.zeros((RUNS, 12))
    speed(
        "1000 runs with held commands, 2 s at 1 ms",
        f"undertow, {threads} thread{'s' if threads > 1 else ''}",
        lambda: simulator.run(x0, t, u, p, max_step=loops.DT, threads=threads),
        rounds=3,
    )
