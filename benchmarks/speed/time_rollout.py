"""What one run of a closed loop costs: 240 s at 1 ms, every fortieth state kept."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import pytest

from undertow.codegen.compiler import find_compiler

from . import hand, hand_python, loops
from .conftest import Speed
from .goals import ROLLOUT

if TYPE_CHECKING:
    from collections.abc import Callable

DURATION, CHECKED = 240.0, 10.0
LIMIT = 1e-10
ROUNDS = 25
# Of slow peers a piece is run and scaled up, and of the virtual machine's memory a call.
PIECE, SHORT, CHUNK = 0.5, 0.1, 2400


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory) -> loops.HandLoop:
    return loops.HandLoop(tmp_path_factory.mktemp("hand"))


@cache
def _ours(duration: float) -> np.ndarray:
    return loops.loop().run_many(loops.scenario(duration), parameters={"m": loops.masses(1)}).states[0]


def _apart(found: np.ndarray) -> float:
    """Largest distance from ours over the rows that are there, at most the first ten seconds."""
    return float(np.abs(found - _ours(CHECKED)[: len(found)]).max())


def time_ours(speed: Speed, by_hand: loops.HandLoop) -> None:
    loop, scenario, mass = loops.loop(), loops.scenario(DURATION), {"m": loops.masses(1)}
    apart = _apart(by_hand.run(CHECKED, loops.masses(1))[0])
    speed(
        ROLLOUT,
        "undertow",
        lambda: loop.run_many(scenario, parameters=mass),
        apart=apart,
        limit=LIMIT,
        rounds=ROUNDS,
    )


def time_hand(speed: Speed, by_hand: loops.HandLoop) -> None:
    samples = round(DURATION / loops.DT) + 1
    p, log = loops.hand_parameters(loops.masses(1)[0])[None], np.empty((1, samples // loops.STRIDE + 1, 12))
    apart = _apart(by_hand.run(CHECKED, loops.masses(1))[0])
    speed(
        ROLLOUT,
        "hand-written C",
        lambda: by_hand.rerun(p, samples, log),
        apart=apart,
        limit=LIMIT,
        rounds=ROUNDS,
    )


def time_with_measures(speed: Speed) -> None:
    """With settling, overshoot and effort, that look at every sample."""
    loop, scenario = loops.loop(), loops.scenario(DURATION)
    found = loop.run(loops.scenario(CHECKED))
    apart = _apart(np.column_stack(list(found.state.values())))
    speed(
        ROLLOUT, "undertow, with its measures", lambda: loop.run(scenario), apart=apart, limit=LIMIT, rounds=3
    )


# --- CasADi -----------------------------------------------------------------------------------------
def _accumulated(samples: int) -> ca.Function:
    """`(x_all, s_end) = f(x, s)`: the closed loop, so many samples."""
    parts = loops.loop().parts
    f, control = parts.functions.dynamics, parts.control
    x, s = ca.SX.sym("x", 12), ca.SX.sym("s", control.size1_in("s"))
    desired, gains, p = ca.DM(loops.TO), ca.DM(parts.gains), ca.DM(parts.parameters)
    u, following, _ = control(parts.outputs(x, 0, p, 0), desired, s, gains, loops.DT)
    h, k = loops.DT, [f(x, u, p, 0)]
    for ahead in (0.5, 0.5, 1.0):
        k.append(f(x + ahead * h * k[-1], u, p, 0))
    last = x + h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
    state = ca.vertcat(x, s)
    step = ca.Function("step", [state], [ca.cse(ca.vertcat(last, following))])
    return step.mapaccum(samples)


@cache
def _compiled_mapaccum(folder: Path) -> ca.Function:
    function, compiler = _accumulated(CHUNK), find_compiler()
    assert compiler is not None
    source = ca.CodeGenerator("accumulated.c")
    source.add(function)
    source.generate(f"{folder}/")
    command = [*compiler.command, *hand.FLAGS, "accumulated.c", "-o", "accumulated.so", "-lm"]
    subprocess.run(command, check=True, cwd=folder)
    return ca.external(function.name(), str(folder / "accumulated.so"))


def _by_casadi(function: ca.Function, duration: float) -> np.ndarray:
    parts = loops.loop().parts
    state = np.concatenate([np.zeros(12), parts.controller.initial_states()])
    rows = [state[None, :12]]
    for _ in range(round(duration / loops.DT / CHUNK)):
        found = np.asarray(function(state))
        state = found[:, -1]
        rows.append(found[:12, loops.STRIDE - 1 :: loops.STRIDE].T)
    return np.concatenate(rows)


def time_casadi(speed: Speed, tmp_path: Path) -> None:
    function = _compiled_mapaccum(tmp_path)
    rows = len(_ours(CHECKED))
    apart = _apart(_by_casadi(function, 12.0)[:rows])
    speed(
        ROLLOUT,
        "CasADi mapaccum, compiled",
        lambda: _by_casadi(function, DURATION),
        apart=apart,
        limit=LIMIT,
        rounds=3,
        more={"samples_per_call": CHUNK},
    )


# --- Python -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("who", "run", "piece"),
    [
        ("NumPy Runge-Kutta", hand_python.numpy_rollout, PIECE),
        ("SciPy solve_ivp", hand_python.scipy_rollout, SHORT),
    ],
)
def time_python(
    speed: Speed, who: str, run: Callable[[float, dict[str, np.ndarray]], np.ndarray], piece: float
) -> None:
    p = hand_python.unpacked(loops.hand_parameters(loops.masses(1)[0]))
    end = round(0.08 / loops.LOGGED)
    apart = float(np.abs(run(0.08, p) - _ours(CHECKED)[end]).max())
    speed(
        ROLLOUT,
        who,
        lambda: run(piece, p),
        calls=piece / DURATION,
        apart=apart,
        limit=LIMIT,
        rounds=3,
        more={"scaled_up_from": f"{piece:g} s"},
    )


@pytest.mark.parametrize("duration", [1.0, 10.0, 100.0, 1000.0])
def time_growth(speed: Speed, duration: float) -> None:
    loop, scenario, mass = loops.loop(), loops.scenario(duration), {"m": loops.masses(1)}
    speed(
        "one closed-loop run of so many seconds at 1 ms",
        "undertow",
        lambda: loop.run_many(scenario, parameters=mass),
        size=duration,
        rounds=3,
    )
