"""Runs of a closed loop: compiled where there is a compiler, in parts so that Ctrl-C is heard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from undertow.codegen.compiler import Compiler, compiled_or_virtual
from undertow.control.controller import Controller
from undertow.control.gains import GainSet
from undertow.model.vehicle import Vehicle
from undertow.typing import Progress

from .compiled import CompiledLoop
from .many import NONE, Differences, Runs, Varied, blocks, run_many
from .measures import Measures
from .parts import Parts
from .problem import LoopProblem, LoopStepper, problem_of
from .record import Record, Recorder
from .sampling import SampledLoop, check_interval, check_steps, offsets
from .scenario import Scenario, heading
from .virtual import VirtualLoop


class ClosedLoop:
    """A vehicle under a controller.

    Parameters
    ----------
    gains : GainSet
        The law with its gains, on the vehicle that the controller knows.
    vehicle : Vehicle, optional
        The vehicle that moves; by default the one that the controller knows.
    compiled : bool, optional
        True compiles (and fails without a C compiler), False uses CasADi's virtual machine; by default
        compiled code is used where a compiler is found.

    Raises
    ------
    UndertowError
        If the vehicle lacks what the controller needs, or compiling fails.
    """

    def __init__(
        self, gains: GainSet, vehicle: Vehicle | None = None, *, compiled: bool | None = None
    ) -> None:
        known = gains.plant.vehicle
        self.vehicle = _with_forces(vehicle or known)
        self.parts = Parts(self.vehicle, Controller(gains))
        self.stepper = self._best_stepper(compiled)
        self._known_substeps: dict[tuple[float, ...], int] = {}

    def _best_stepper(self, wish: bool | None) -> LoopStepper:
        def compiled(compiler: Compiler) -> LoopStepper:
            return CompiledLoop(self.parts, compiler)

        def virtual() -> LoopStepper:
            return VirtualLoop(self.parts)

        return compiled_or_virtual(wish, compiled, virtual)

    @property
    def gains(self) -> GainSet:
        """The gain set."""
        return self.parts.controller.gains

    # --- set-points -----------------------------------------------------------------------------
    def desired(self, scenario: Scenario) -> tuple[dict[str, float], dict[str, float]]:
        """Start and set-point of a run in the vehicle's coordinates, the heading worked out if not given."""
        names = self.vehicle.pose_names
        zero = dict.fromkeys(names, 0.0)
        start = zero | (scenario.pose(scenario.start, names, "start") if scenario.start else {})
        given = scenario.pose(scenario.to, names, "set-point")
        to = zero | given
        if "psi" in names and "psi" not in given:
            here = start.get("x") is not None and start.get("y") is not None
            to["psi"] = heading(self.gains.schedule.heading, start, to) if here else start["psi"]
        return start, to

    # --- running --------------------------------------------------------------------------------
    @np.errstate(over="ignore", invalid="ignore")  # what diverges is told of in words
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
        start, to = self.desired(scenario)
        problem = self.problem(scenario, start, to, self.first(scenario, start)[None])
        left = {} if scenario.continuous else offsets(self.parts, scenario.dt)
        measures, recorder = Measures(self, scenario, start, to, left), Recorder(self, scenario)
        for block in blocks(self.parts, scenario, range(1)):
            rows = self.stepper.run(problem, block).of(0)
            credible = measures.add(block.first, rows)
            recorder.add(block.first, rows.first(credible))
            if progress is not None:
                progress((block.first + block.samples) * scenario.dt, self.gains.name)
            if measures.diverged is not None:
                break
        return recorder.record(start, to, measures)

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

        Parameters
        ----------
        scenario : Scenario
            What is asked of all. Run i has the noise of seed + i, so that it is what `run` with that seed is.
        parameters, gains, starts : mapping, optional
            What differs, an array of a value for each run by name: parameters of the vehicle that moves (m,
            X_udot ..., SNAME signs), gains (K_P_x ...), and first pose and velocity (x ... psi, u ... r), SI.
        threads : int, optional
            How many; by default as many as there are processors.
        progress : callable, optional
            Called with the number of runs that are done and a few words.

        Returns
        -------
        Runs
            The rows of all runs.

        Raises
        ------
        UndertowError
            As for `run`, and if a name is not known, numbers of values differ, or dead times do.

        Examples
        --------
        >>> masses = numpy.random.default_rng(0).normal(7.5, 0.3, 1000)
        >>> runs = loop.run_many(Scenario((1, 1, 1)), parameters={"m": masses})
        >>> runs.state("z")[:, -1].std()
        """
        return run_many(self, scenario, Differences(parameters, gains, starts), threads, progress)

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
        desired = np.array([to[n] for n in self.gains.plant.vehicle.pose_names])
        substeps = self._substeps(scenario, start, to, desired)
        return problem_of(self.parts, first, desired, scenario.dt, substeps, scenario.continuous, p, k)

    def _substeps(
        self, scenario: Scenario, start: Mapping[str, float], to: Mapping[str, float], desired: np.ndarray
    ) -> int:
        """Runge-Kutta steps in an interval that is not too long; kept for the last one asked for."""
        key = (scenario.dt, scenario.continuous, scenario.samples, *start.values(), *to.values())
        if key not in self._known_substeps:
            linear = SampledLoop(self.parts, np.array(list(to.values())), desired)
            if scenario.continuous:
                check_steps(linear, self.parts, scenario.dt, scenario.samples)
            else:
                moves = {n: to[n] - start[n] for n in self.gains.plant.vehicle.pose_names}
                check_interval(linear, self.parts, scenario.dt, moves)
            self._known_substeps = {key: linear.substeps(scenario.dt, scenario.continuous)}
        return self._known_substeps[key]


def _with_forces(vehicle: Vehicle) -> Vehicle:
    """The vehicle with a channel for forces from outside in each of its degrees of freedom."""
    names = tuple(f"tau_{'XYZKMN'[i]}" for i in vehicle.dof_indices)
    return replace(vehicle, force_channels=names)
