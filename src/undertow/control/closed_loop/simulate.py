"""Runs of a closed loop, one or many that differ, in parts so that Ctrl-C takes effect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from undertow.codegen.compiler import compiled_or_virtual
from undertow.codegen.engine import in_threads, shares
from undertow.control.controller import Controller
from undertow.control.gains import GainSet, GainTable, load_gains
from undertow.control.guidance.mission import Mission
from undertow.control.plant import in_current
from undertow.errors import UndertowError, refuse_unknown
from undertow.model.vehicle import Vehicle
from undertow.observer.design import Design, load_observer
from undertow.observer.process import require_stable_step
from undertow.typing import Progress

from .interconnection import Interconnection, SampledLoop, check_interval, check_steps, sampling_offsets
from .measures import Measures, implausible
from .record import Record, Recorder
from .scenario import RUNS, Scenario, heading
from .stepping import SIGNALS, Block, CompiledLoop, LoopProblem, LoopStepper, VirtualLoop, problem_of

Varied = Mapping[str, np.ndarray]
NONE: Varied = MappingProxyType({})


@dataclass(frozen=True)
class RunVariations:
    """What differs from run to run, an array of a value for each run by name."""

    parameters: Varied
    gains: Varied
    starts: Varied

    def __post_init__(self) -> None:
        sizes = {name: np.shape(v) for name, v in self._all().items()}
        if not sizes:
            raise UndertowError("the runs are all the same: give arrays of parameters, gains or starts")
        first, shape = next(iter(sizes.items()))
        odd = [n for n, s in sizes.items() if len(s) != 1 or s != shape or not s[0]]
        if odd:
            raise UndertowError(
                f"'{odd[0]}' has shape {sizes[odd[0]]} but '{first}' has {shape}: give each one value for "
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

    def rows_with(self, what: str, varied: Varied, names: tuple[str, ...], values: np.ndarray) -> np.ndarray:
        """A row of values for each run, those that differ put in, shape (b, n)."""
        rows = np.tile(values, (self.runs, 1))
        refuse_unknown(varied, names, f"{what} ", " is not known", "they are")
        for name, column in varied.items():
            rows[:, names.index(name)] = column
        return rows


@dataclass(frozen=True)
class Runs:
    """Many runs."""

    t: np.ndarray  # (n,): times of the rows, s
    # (b, n, nx): true states; NaN from the first row on at which a run has diverged: it is no number any
    # more, or none that a vehicle in water can have (`implausible`)
    states: np.ndarray
    commands: np.ndarray  # (b, n, nu): commands that the controller gives at the rows
    # state_names, command_names: names of the last axes
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
    diverged = np.maximum.accumulate(implausible(states, states[:, 0, :pose], runs.t).any(axis=2), axis=1)
    if not diverged[:, -1].any():
        return
    runs.states[share][diverged] = np.nan
    runs.commands[share][diverged] = np.nan


# --- blocks of runs -------------------------------------------------------------------------------
def blocks(
    parts: Interconnection,
    scenario: Scenario,
    runs: range,
    stride: int = 1,
    signals: tuple[str, ...] = SIGNALS,
) -> Iterator[Block]:
    """Blocks of samples one after the other, so that Ctrl-C takes effect in between.

    The noise of run i is that of seed + i.
    """
    sensors = parts.observer.noise if parts.observer else {}
    sigmas = replace(scenario, noise={**sensors, **scenario.noise}).noise_of(parts.reported_names)
    random = [np.random.default_rng(scenario.seed + i) for i in runs] if sigmas.any() else []
    for push in scenario.pushes:
        if f"tau_{push.axis}" not in parts.vehicle.command_names:
            raise UndertowError(
                f"force {push.axis} pushes where '{parts.vehicle.name}' does not move: it has "
                f"{', '.join(parts.vehicle.degrees_of_freedom)}"
            )
    for begin in range(0, scenario.samples, RUNS.samples_per_call):
        count = min(RUNS.samples_per_call, scenario.samples - begin)
        noise = [r.standard_normal((count, len(sigmas))) * sigmas for r in random]
        extra = _disturbance(parts, scenario, begin, count) if scenario.pushes else None
        yield Block(begin, count, stride, np.stack(noise) if noise else None, extra, signals)


def _disturbance(parts: Interconnection, scenario: Scenario, begin: int, count: int) -> np.ndarray:
    commands = parts.vehicle.command_names
    extra = np.zeros((count, len(commands)))
    t = (begin + np.arange(count)) * scenario.dt
    for push in scenario.pushes:
        extra[(t >= push.begin) & (t < push.end), commands.index(f"tau_{push.axis}")] += push.value
    return extra


class ClosedLoop:
    """A vehicle under a controller.

    Parameters
    ----------
    gains : GainSet
        The law with its gains, on the vehicle that the controller knows.
    vehicle : Vehicle, optional
        The vehicle that moves; by default the one that the controller knows.
    mission : Mission, optional
        What is followed instead of the set-point of a scenario.
    compiled : bool, optional
        True compiles (and fails without a C compiler), False uses CasADi's virtual machine; by default
        compiled code is used where a compiler is found.
    observer : Design, optional
        Gives the controller an estimate in place of the reports; noise that a scenario does not state is then
        that of its sensors.

    Raises
    ------
    UndertowError
        If the vehicle lacks what the controller or the mission needs, or compiling fails.
    """

    def __init__(
        self,
        gains: GainSet,
        vehicle: Vehicle | None = None,
        *,
        mission: Mission | None = None,
        observer: Design | None = None,
        compiled: bool | None = None,
    ) -> None:
        known = gains.plant.vehicle
        # The vehicle with a channel for forces from outside in each of its degrees of freedom.
        vehicle = vehicle or known
        names = tuple(f"tau_{'XYZKMN'[i]}" for i in vehicle.dof_indices)
        self.vehicle = replace(vehicle, force_channels=names)
        self.mission = mission
        controller = Controller(gains, mission.reference(gains) if mission else None)
        self._compiled = compiled
        self.parts = Interconnection(self.vehicle, controller, observer)
        # With late reports the code depends on the sampling interval: it is made when that is known.
        self._stepper = None if observer and observer.late else self._best_stepper()
        self._known_substeps: dict[tuple[float, ...], int] = {}

    @property
    def stepper(self) -> LoopStepper:
        """What runs the samples."""
        self._stepper = self._stepper or self._best_stepper()
        return self._stepper

    def _best_stepper(self) -> LoopStepper:
        return compiled_or_virtual(
            self._compiled, partial(CompiledLoop, self.parts), partial(VirtualLoop, self.parts)
        )

    def _set_interval(self, dt: float) -> None:
        """Let an observer keep as many samples as its reports are late."""
        observer = self.parts.observer
        if observer is not None and (kept := observer.sampled(dt)).lags != observer.lags:
            self.parts, self._stepper = Interconnection(self.vehicle, self.parts.controller, kept), None

    @property
    def gains(self) -> GainSet:
        """The gain set."""
        return self.parts.controller.gains

    # --- set-points -----------------------------------------------------------------------------
    def desired(self, scenario: Scenario) -> tuple[dict[str, float], dict[str, float]]:
        """Start and set-point of a run in the vehicle's coordinates, the heading worked out if not given."""
        names = self.vehicle.pose_names
        zero = dict.fromkeys(names, 0.0)
        reference = self.parts.controller.reference
        if reference is not None:
            known = self.gains.plant.vehicle.pose_names
            begin, end = (
                zero | dict(zip(known, map(float, p), strict=True)) for p in (reference.start, reference.end)
            )
            return begin | (scenario.pose(scenario.start, names, "start") if scenario.start else {}), end
        start = zero | (scenario.pose(scenario.start, names, "start") if scenario.start else {})
        given = scenario.pose(scenario.to, names, "set-point")
        to = zero | given
        if "psi" in names and "psi" not in given:
            here = start.get("x") is not None and start.get("y") is not None
            to["psi"] = heading(self.gains.schedule.heading, start, to) if here else start["psi"]
        return start, to

    # --- running --------------------------------------------------------------------------------
    @np.errstate(over="ignore", invalid="ignore")  # what diverges is reported in words
    def run(self, scenario: Scenario, progress: Progress | None = None) -> Record:
        """Simulate.

        Parameters
        ----------
        scenario : Scenario
            What is asked.
        progress : callable, optional
            Called with the simulated time in s and a few words.

        Returns
        -------
        Record
            Rows over time and the measures of the run.

        Raises
        ------
        UndertowError
            If the scenario does not fit the vehicle, or dt is too long for the law.
        """
        self._set_interval(scenario.dt)
        start, to = self.desired(scenario)
        problem = self.problem(scenario, start, to, self.first(scenario, start)[None])
        sampling_offset = {} if scenario.continuous else sampling_offsets(self.parts, scenario.dt)
        measures, recorder = (
            Measures(self.parts, scenario, start, to, sampling_offset),
            Recorder(self.parts, scenario, self.mission),
        )
        for block in blocks(self.parts, scenario, range(1)):
            rows = self.stepper.run(problem, block).of(0)
            credible = measures.add(block.first, rows)
            recorder.add(block.first, rows.first(credible))
            if progress is not None:
                progress((block.first + block.samples) * scenario.dt, self.gains.name)
            if measures.diverged is not None:
                break
        return recorder.record(start, to, measures)

    @np.errstate(over="ignore", invalid="ignore")  # runs that diverge are NaN
    def run_many(
        self,
        scenario: Scenario,
        *,
        parameters: Varied = NONE,
        gains: Varied = NONE,
        starts: Varied = NONE,
        threads: int | None = None,
        progress: Progress | None = None,
    ) -> Runs:
        """Simulate many runs that differ, side by side in the lanes of vectors and in threads.

        `parameters` (of the vehicle that moves: m, X_udot ..., SNAME signs), `gains` (K_P_x ..., and
        limit_f1 ... of commands that have a limit) and `starts` (first pose and velocity: x ... psi,
        u ... r, SI) have an array of a value for each run by name. Run i has the noise of seed + i, so that
        it is what `run` with that seed is. By default as many threads as there are processors. For example::

            masses = numpy.random.default_rng(0).normal(7.5, 0.3, 1000)
            loop.run_many(Scenario((1, 1, 1)), parameters={"m": masses}).state("z")[:, -1].std()
        """
        self._set_interval(scenario.dt)
        by = RunVariations(parameters, gains, starts)
        parts = self.parts
        start, to = self.desired(scenario)
        named = (*self.vehicle.pose_names, *self.vehicle.velocity_names)
        problem = self.problem(
            scenario,
            start,
            to,
            by.rows_with("start of", by.starts, named, self.first(scenario, start)),
            by.rows_with("parameter", by.parameters, parts.functions.parameter_names, parts.parameters),
            by.rows_with("gain", by.gains, parts.controller.gain_names, parts.gains),
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
            _simulate(self, scenario, problem.part(share), share, runs)

        done = 0

        def report(share: slice) -> None:
            nonlocal done
            done += share.stop - share.start
            if progress is not None:
                progress(done, self.gains.name)

        steps = scenario.samples * problem.substeps
        threads = threads if self.stepper.parallel else 1
        in_threads(simulate, shares(by.runs, steps, threads, self.stepper.lanes), threads, report)
        return runs

    # --- preparing ------------------------------------------------------------------------------
    def first(self, scenario: Scenario, start: Mapping[str, float]) -> np.ndarray:
        """First pose and velocity of a scenario."""
        return np.array([*start.values(), *scenario.velocity(self.vehicle.velocity_names)])

    def problem(
        self,
        scenario: Scenario,
        start: Mapping[str, float],
        to: Mapping[str, float],
        first: np.ndarray,
        p: np.ndarray | None = None,
        k: np.ndarray | None = None,
    ) -> LoopProblem:
        """Runs of a scenario from the states `first` on, with parameters and gains of their own if given."""
        if self.parts.observer:
            if scenario.continuous:
                raise UndertowError("an observer needs a sampled law: leave out one of the two")
            require_stable_step(self.parts.observer.process, scenario.dt)
        desired = np.array([to[n] for n in self.gains.plant.vehicle.pose_names])
        substeps = self._substeps(scenario, start, to, desired)
        reference = self.parts.controller.reference
        if reference is not None:
            if scenario.continuous and not reference.continuous:
                raise UndertowError("legs are guided sample by sample: leave out --continuous")
            desired = np.array(self.parts.controller.mission_numbers)
        return problem_of(self.parts, first, desired, scenario.dt, substeps, scenario.continuous, p, k)

    def _substeps(
        self, scenario: Scenario, start: Mapping[str, float], to: Mapping[str, float], desired: np.ndarray
    ) -> int:
        """Runge-Kutta steps in an interval that is not too long; kept for the last one asked for."""
        key = (scenario.dt, scenario.continuous, scenario.samples, *start.values(), *to.values())
        if key not in self._known_substeps:
            still = Interconnection(self.vehicle, Controller(self.gains)) if self.mission else self.parts
            linear = SampledLoop(still, np.array(list(to.values())), desired)
            if scenario.continuous:
                check_steps(linear, self.parts, scenario.dt, scenario.samples)
            else:
                moves = {n: to[n] - start[n] for n in self.gains.plant.vehicle.pose_names}
                check_interval(linear, self.parts, scenario.dt, moves)
            self._known_substeps = {key: linear.substeps(scenario.dt, scenario.continuous)}
        return self._known_substeps[key]


_SWAY_FORCE = "tau_Y"


@dataclass(frozen=True)
class Overrides:
    """Changes to what the vehicle file and the gain file say; None leaves what they say."""

    # order, heading, integrators: as in [schedule] of a gain file
    order: Literal["together", "yaw-first"] | None = None
    heading: Literal["atan", "atan2"] | None = None
    integrators: Literal["gate", "start"] | None = None
    gate: str | None = None  # error of the heading that opens the gate, with its unit
    # "actuated" gives the vehicle an ideal sway force, "unactuated" leaves that force out
    sway: Literal["actuated", "unactuated"] | None = None
    # velocity of the water to the north and to the east, m/s; the controller does not know of it
    current: tuple[float, float] | None = None

    def loop(
        self,
        gains: str | Path,
        vehicle: Vehicle,
        plant: Vehicle | None = None,
        *,
        mission: Mission | None = None,
        compiled: bool | None = None,
        observer: str | Path | None = None,
    ) -> ClosedLoop:
        """A closed loop with these choices.

        `gains` and `observer` are files, or names of bundled ones, for the vehicle that the controller knows;
        `plant` is the vehicle that moves, by default the same. The current of a mission is the default.
        """
        known = self.with_sway(vehicle)
        in_water = replace(self, current=mission.current) if mission and self.current is None else self
        moving = in_water.in_current(self.with_sway(plant) if plant else known)
        chosen = None if observer is None else load_observer(observer, known)
        law = load_gains(gains, known, self.applied_to)
        return ClosedLoop(law, moving, mission=mission, observer=chosen, compiled=compiled)

    def applied_to(self, table: GainTable) -> GainTable:
        """A gain file with these choices."""
        names = ("order", "heading", "integrators", "gate")
        wanted = {n: getattr(self, n) for n in names if getattr(self, n) is not None}
        left_out = [d for d in table.unactuated if d != "sway" or self.sway is None]
        if self.sway == "unactuated":
            left_out.append("sway")
        schedule = table.schedule.model_copy(update=wanted)
        return table.model_copy(update={"schedule": schedule, "unactuated": left_out})

    def with_sway(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle with a sway force if there is to be one."""
        if self.sway != "actuated" or _SWAY_FORCE in vehicle.force_channels:
            return vehicle
        if "sway" not in vehicle.degrees_of_freedom:
            raise UndertowError(f"vehicle '{vehicle.name}' has no sway that could be actuated")
        return replace(vehicle, force_channels=(*vehicle.force_channels, _SWAY_FORCE))

    def in_current(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle in the current if there is to be one."""
        return vehicle if self.current is None else in_current(vehicle, *self.current)


def without_effects(vehicle: Vehicle, ids: Sequence[str]) -> Vehicle:
    """The vehicle with some of its effects left out."""
    present = [e.id for e in vehicle.effects]
    absent = f" cannot be left out, '{vehicle.name}' does not have it"
    refuse_unknown(ids, present, "effect ", absent, "it has")
    return replace(vehicle, effects=tuple(e for e in vehicle.effects if e.id not in ids))


def simulate_each(
    vehicle: Vehicle,
    gains: Sequence[str],
    scenario: Scenario,
    overrides: Overrides,
    *,
    plant: Vehicle | None = None,
    observer: str | Path | None = None,
    mission: Mission | None = None,
    progress: Progress = lambda done, words: None,
) -> list[Record]:
    """A run with every gain file; `progress` gets the seconds that are done, all runs together."""

    def run(index: int, name: str) -> Record:
        before = index * scenario.duration
        loop = overrides.loop(name, vehicle, plant, mission=mission, observer=observer)
        return loop.run(scenario, lambda done, words: progress(before + done, words))

    return [run(i, name) for i, name in enumerate(gains)]
