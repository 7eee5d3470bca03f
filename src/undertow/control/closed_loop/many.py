"""Many runs of a closed loop that differ in parameters, gains or first states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from undertow.codegen.lanes import in_threads, shares
from undertow.errors import UndertowError
from undertow.model.catalogue import nearest
from undertow.typing import Progress

from .measures import CREDIBLE

if TYPE_CHECKING:
    from .problem import LoopProblem
    from .scenario import Scenario
    from .simulate import ClosedLoop

from collections.abc import Iterator

from .parts import Parts
from .problem import ALL, Block
from .scenario import Scenario

Varied = Mapping[str, np.ndarray]
NONE: Varied = MappingProxyType({})


@dataclass(frozen=True)
class Differences:
    """What differs from run to run, an array of a value for each run by name."""

    parameters: Varied
    gains: Varied
    starts: Varied

    def __post_init__(self) -> None:
        sizes = {name: np.shape(v) for name, v in self._all().items()}
        if not sizes:
            raise UndertowError("runs do not differ: give arrays of parameters, gains or starts")
        first, shape = next(iter(sizes.items()))
        odd = [n for n, s in sizes.items() if len(s) != 1 or s != shape or not s[0]]
        if odd:
            raise UndertowError(
                f"'{odd[0]}' has shape {sizes[odd[0]]} where '{first}' has {shape}: give each one value for "
                "every run"
            )
        for name, values in self._all().items():
            if not np.isfinite(np.asarray(values, dtype=float)).all():
                raise UndertowError(f"'{name}' has values that are not finite: leave those runs out")

    def _all(self) -> dict[str, np.ndarray]:
        return {**self.parameters, **self.gains, **self.starts}

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return len(next(iter(self._all().values())))

    def put_into(self, what: str, varied: Varied, names: tuple[str, ...], values: np.ndarray) -> np.ndarray:
        """A row of values for each run, those that differ put in, shape (b, n)."""
        rows = np.tile(values, (self.runs, 1))
        for name, column in varied.items():
            if name not in names:
                raise UndertowError(
                    f"{what} '{name}' is not known{nearest(name, names)}: they are {', '.join(names)}"
                )
            rows[:, names.index(name)] = column
        return rows


@dataclass(frozen=True)
class Runs:
    """Many runs.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times of the rows, s.
    states : ndarray, shape (b, n, nx)
        True states; NaN from the first row on at which a run has diverged: it is no number any more, or none
        that a vehicle in water can have (`Credible`).
    commands : ndarray, shape (b, n, nu)
        Commands that the controller gives at the rows.
    state_names, command_names : tuple of str
        Names of the last axes.
    """

    t: np.ndarray
    states: np.ndarray
    commands: np.ndarray
    state_names: tuple[str, ...]
    command_names: tuple[str, ...]

    def state(self, name: str) -> np.ndarray:
        """One state of all runs, shape (b, n)."""
        return self.states[:, :, self.state_names.index(name)]

    def command(self, name: str) -> np.ndarray:
        """One command of all runs, shape (b, n)."""
        return self.commands[:, :, self.command_names.index(name)]

    @property
    def diverged(self) -> np.ndarray:
        """Which runs have diverged before the end, shape (b,)."""
        return np.isnan(self.states[:, -1]).any(axis=1)


@np.errstate(over="ignore", invalid="ignore")  # runs that diverge are NaN
def run_many(
    loop: ClosedLoop, scenario: Scenario, by: Differences, threads: int | None, progress: Progress | None
) -> Runs:
    """What `ClosedLoop.run_many` does."""
    parts = loop.parts
    start, to = loop.desired(scenario)
    named = (*loop.vehicle.pose_names, *loop.vehicle.velocity_names)
    problem = loop.problem(
        scenario,
        start,
        to,
        by.put_into("start of", by.starts, named, loop.first(scenario, start)),
        by.put_into("parameter", by.parameters, parts.functions.parameter_names, parts.parameters),
        by.put_into("gain", by.gains, parts.controller.gain_names, parts.gains),
    )
    t = np.arange(0, scenario.samples, scenario.stride) * scenario.dt
    runs = Runs(
        t,
        np.full((by.runs, len(t), problem.x.shape[1]), np.nan),
        np.full((by.runs, len(t), len(parts.commanded)), np.nan),
        parts.functions.state_names,
        parts.controller.command_names,
    )

    def simulate(share: slice) -> None:
        _simulate(loop, scenario, problem.part(share), share, runs)

    done = 0

    def tell(share: slice) -> None:
        nonlocal done
        done += share.stop - share.start
        if progress is not None:
            progress(done, loop.gains.name)

    steps = scenario.samples * problem.substeps
    threads = threads if loop.stepper.parallel else 1
    in_threads(simulate, shares(by.runs, steps, threads, loop.stepper.lanes), threads, tell)
    return runs


def _simulate(loop: ClosedLoop, scenario: Scenario, problem: LoopProblem, share: slice, runs: Runs) -> None:
    """Fill in the rows of some of the runs."""
    row, numbers = 0, range(share.start, share.stop)
    for block in blocks(loop.parts, scenario, numbers, scenario.stride, ("x", "u")):
        found = loop.stepper.run(problem, block)
        rows = slice(row, row + len(block.recorded))
        runs.states[share, rows] = found.x
        runs.commands[share, rows] = found.u[:, :, loop.parts.commanded]
        row = rows.stop
    pose = len(loop.vehicle.pose_names)
    states = runs.states[share]
    lost = CREDIBLE.broken(states, states[:, 0, :pose], runs.t).any(axis=2)
    gone = np.maximum.accumulate(lost, axis=1)
    if not gone[:, -1].any():
        return
    runs.states[share][gone] = np.nan
    runs.commands[share][gone] = np.nan


# --- blocks of runs -------------------------------------------------------------------------------
_SAMPLES_PER_CALL = 20_000


def blocks(
    parts: Parts, scenario: Scenario, runs: range, stride: int = 1, wanted: tuple[str, ...] = ALL
) -> Iterator[Block]:
    """Blocks of samples one after the other, so that Ctrl-C is heard in between.

    The noise of run i is that of seed + i.
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
