"""Clocks in closed loops: a controller answers what the model lacks, so that commands foretell motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from tests.quick import first_quick
from undertow.codegen import Functions, Simulator
from undertow.identification.doctor.examine import examine
from undertow.identification.findings import Finding
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle

NOISE = {"x": 0.02, "y": 0.02, "psi": 0.003, "u": 0.01, "v": 0.01, "r": 0.002}


@dataclass(frozen=True)
class Loop:
    """A vehicle that a PD controller keeps on headings that step, beside gusts that no model knows."""

    ahead: Mapping[str, float]  # commands that drive it
    turn: Mapping[str, float]  # what one unit of the controller's output adds to the commands
    gains: tuple[float, float]  # per rad, and per rad/s
    limit: float
    speed: float  # m/s at the start
    step: float  # s
    seconds: float
    hold: float  # s between steps of the heading
    gust: tuple[float, float]  # force in sway and moment in yaw, rms, N and N m
    lasting: float  # s, time constant of the gusts
    late: float  # s by which the clock of the commands is shifted where it is


LOOPS = {
    "otter": Loop(
        ahead={"port": 60.0, "starboard": 60.0},
        turn={"port": 1.0, "starboard": -1.0},
        gains=(60.0, 40.0),
        limit=50.0,
        speed=1.4,
        step=0.2,
        seconds=200.0,
        hold=40.0,
        gust=(10.0, 15.0),
        lasting=4.0,
        late=2.0,
    ),
    "kvlcc2": Loop(
        ahead={"propeller": 10.0},
        turn={"rudder": 1.0},
        gains=(1.0, 6.0),
        limit=0.6,
        speed=1.0,
        step=0.5,
        seconds=600.0,
        hold=120.0,
        gust=(20.0, 20.0),
        lasting=6.0,
        late=5.0,
    ),
}


@cache
def _log(name: str, gusts: float, seed: int) -> Run:
    """A log of a loop with a share of its gusts."""
    loop, random = LOOPS[name], np.random.default_rng(seed)
    truth = replace(load_vehicle(name), force_channels=("tau_Y", "tau_N"))
    functions = Functions(truth)
    simulator, p = Simulator(functions), np.array(functions.values(), dtype=float)
    count, fading = round(loop.seconds / loop.step), np.exp(-loop.step / loop.lasting)
    t = loop.step * np.arange(count)
    wanted = np.repeat(random.uniform(-0.8, 0.8, count), round(loop.hold / loop.step))[:count]
    state, gust = np.zeros(len(functions.state_names)), np.zeros(2)
    state[3] = loop.speed
    states, commands = [], []
    for i in range(count):
        error = np.angle(np.exp(1j * (wanted[i] - state[2])))
        output = np.clip(loop.gains @ np.array([error, -state[5]]), -loop.limit, loop.limit)
        new = np.sqrt(1 - fading**2) * random.standard_normal(2) * loop.gust
        gust = fading * gust + gusts * new
        given = dict(zip(truth.force_channels, gust, strict=True))
        given |= {n: loop.ahead.get(n, 0.0) + loop.turn.get(n, 0.0) * output for n in truth.actuator_names}
        u = np.array([given[n] for n in truth.command_names])
        states.append(state)
        commands.append(u)
        state = simulator.run(state, t[i] + np.array([0.0, loop.step]), np.tile(u, (2, 1)), p)[-1]
    measured = np.array(states)[:, :6] + random.standard_normal((count, 6)) * [*NOISE.values()]
    channels = dict(zip(NOISE, measured.T, strict=True))
    return Run("loop", t, channels | dict(zip(truth.actuator_names, np.array(commands).T, strict=False)))


def _with_late_commands(run: Run, names: tuple[str, ...], seconds: float) -> Run:
    """Commands with the stamps of a clock that is that much behind."""
    k = round(seconds / run.step)
    moved = {n: c[:-k] if n in names else c[k:] for n, c in run.channels.items()}
    return Run("late", run.t[k:], moved)


def _on_clocks(name: str, run: Run) -> list[Finding]:
    found = examine(load_vehicle(name), [run]).result.findings
    return [f for f in found if f.id in ("late_commands", "command_latency", "two_clocks", "late_pose")]


@pytest.mark.parametrize(("name", "seed"), first_quick([("otter", 0), ("kvlcc2", 0), ("otter", 1)]))
def test_commands_that_answer_gusts_are_no_sign_of_a_wrong_clock(name: str, seed: int) -> None:
    """The fit is a little better for commands that are read earlier, in every one of these logs."""
    for found in _on_clocks(name, _log(name, 0.1, seed)):
        assert found.severity == "note", found.text
        assert found.evidence["delay"] < 0
        assert "proves no clock error: a controller" in found.text


@pytest.mark.parametrize(("name", "gusts"), first_quick([("kvlcc2", 0.1), ("otter", 0.0)]))
def test_a_clock_that_is_wrong_shows_in_a_closed_loop_too(name: str, gusts: float) -> None:
    seconds, run = LOOPS[name].late, _log(name, gusts, 1)
    (found,) = _on_clocks(name, _with_late_commands(run, load_vehicle(name).actuator_names, seconds))
    assert (found.id, found.severity) == ("late_commands", "mistake")
    assert found.evidence["delay"] == pytest.approx(-seconds, abs=1.5 * run.step)
    assert ", which is impossible" in found.text
