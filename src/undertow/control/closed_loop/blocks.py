"""The samples of a scenario, block by block, with noise and forces from outside."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from undertow.errors import UndertowError

from .parts import Parts
from .problem import ALL, Block
from .scenario import Scenario

_SAMPLES_PER_CALL = 20_000


def blocks(
    parts: Parts, scenario: Scenario, runs: range, stride: int = 1, wanted: tuple[str, ...] = ALL
) -> Iterator[Block]:
    """Blocks of samples one after the other, so that Ctrl-C is heard in between.

    Parameters
    ----------
    parts : Parts
        The loop that runs.
    scenario : Scenario
        What is asked.
    runs : range
        Numbers of the runs: the noise of run i is that of seed + i.
    stride : int
        Every how many-th sample is recorded.
    wanted : tuple of str
        What is recorded.

    Raises
    ------
    UndertowError
        If noise or a push is meant for what the vehicle does not have.
    """
    spread = scenario.noise_of(parts.reported_names)
    random = [np.random.default_rng(scenario.seed + i) for i in runs] if spread.any() else []
    _check_pushes(parts, scenario)
    for begin in range(0, scenario.samples, _SAMPLES_PER_CALL):
        count = min(_SAMPLES_PER_CALL, scenario.samples - begin)
        noise = [r.standard_normal((count, len(spread))) * spread for r in random]
        extra = _extra(parts, scenario, begin, count) if scenario.pushes else None
        yield Block(begin, count, stride, np.stack(noise) if noise else None, extra, wanted)


def _check_pushes(parts: Parts, scenario: Scenario) -> None:
    for push in scenario.pushes:
        if f"tau_{push.axis}" not in parts.vehicle.command_names:
            raise UndertowError(
                f"force {push.axis} pushes where '{parts.vehicle.name}' does not move: it has "
                f"{', '.join(parts.vehicle.degrees_of_freedom)}"
            )


def _extra(parts: Parts, scenario: Scenario, begin: int, count: int) -> np.ndarray:
    commands = parts.vehicle.command_names
    extra = np.zeros((count, len(commands)))
    t = (begin + np.arange(count)) * scenario.dt
    for push in scenario.pushes:
        extra[(t >= push.begin) & (t < push.end), commands.index(f"tau_{push.axis}")] += push.value
    return extra
