"""Runs of a closed loop: compiled where there is a compiler, in parts so that Ctrl-C is heard."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from undertow.codegen.compiler import Compiler, compiled_or_virtual
from undertow.control.controller import Controller
from undertow.control.gains import GainSet
from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle

from .compiled import CompiledLoop
from .measures import Measures
from .parts import Parts
from .problem import LoopStepper, problem_of
from .record import Record, Recorder
from .sampling import SampledLoop, check_interval, check_steps, offsets
from .scenario import Scenario, heading
from .virtual import VirtualLoop

_SAMPLES_PER_CALL = 20_000
Report = Callable[[float, str], None]


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
        compiled code is used where a compiler is found, else numba where it is installed.

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
        self._stepper = self._best_stepper(compiled)

    def _best_stepper(self, wish: bool | None) -> LoopStepper:
        def compiled(compiler: Compiler) -> LoopStepper:
            return CompiledLoop(self.parts, compiler)

        def virtual() -> LoopStepper:
            return VirtualLoop(self.parts)

        def interpreted() -> LoopStepper:
            from .interpreted import InterpretedLoop

            return InterpretedLoop(self.parts)

        return compiled_or_virtual(wish, compiled, virtual, interpreted)

    @property
    def gains(self) -> GainSet:
        """The gain set."""
        return self.parts.controller.gains

    # --- set-points -----------------------------------------------------------------------------
    def desired(self, scenario: Scenario) -> tuple[dict[str, float], dict[str, float]]:
        """Start and set-point of a run in the vehicle's coordinates, the heading worked out if not given.

        Raises
        ------
        UndertowError
            If the numbers of values do not fit the vehicle.
        """
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
    def run(self, scenario: Scenario, progress: Report | None = None) -> Record:
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
        parts, known = self.parts, self.gains.plant.vehicle
        moves = {name: to[name] - start[name] for name in known.pose_names}
        goal, desired = np.array(list(to.values())), np.array([to[n] for n in known.pose_names])
        linear = SampledLoop(parts, goal, desired)
        if scenario.continuous:
            check_steps(linear, parts, scenario.dt, scenario.samples)
        else:
            check_interval(linear, parts, scenario.dt, moves)
        substeps = linear.substeps(scenario.dt, scenario.continuous)
        first = np.array([*start.values(), *scenario.velocity(self.vehicle.velocity_names)])
        problem = problem_of(parts, first, desired, scenario.dt, substeps, scenario.continuous)
        left = {} if scenario.continuous else offsets(parts, scenario.dt)
        measures, recorder = Measures(self, scenario, start, to, left), Recorder(self, scenario)
        for begin, noise, extra in self._blocks(scenario):
            rows = self._stepper.run(problem, begin, noise, extra)
            measures.add(begin, rows)
            recorder.add(begin, rows)
            if progress is not None:
                progress((begin + len(noise)) * scenario.dt, self.gains.name)
            if not np.isfinite(rows.x).all():
                break
        return recorder.record(start, to, measures)

    def _blocks(self, scenario: Scenario) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """First sample, noise and disturbing forces of one call after the other."""
        random = np.random.default_rng(scenario.seed)
        spread = scenario.noise_of(self.parts.reported_names)
        for begin in range(0, scenario.samples, _SAMPLES_PER_CALL):
            count = min(_SAMPLES_PER_CALL, scenario.samples - begin)
            noise = random.standard_normal((count, len(spread))) * spread
            yield begin, noise, self._extra(scenario, begin, count)

    def _extra(self, scenario: Scenario, begin: int, count: int) -> np.ndarray:
        commands = self.vehicle.command_names
        extra = np.zeros((count, len(commands)))
        t = (begin + np.arange(count)) * scenario.dt
        for push in scenario.pushes:
            name = f"tau_{push.axis}"
            if name not in commands:
                raise UndertowError(
                    f"force {push.axis} pushes where '{self.vehicle.name}' does not move: it has "
                    f"{', '.join(self.vehicle.degrees_of_freedom)}"
                )
            extra[(t >= push.begin) & (t < push.end), commands.index(name)] += push.value
        return extra


def _with_forces(vehicle: Vehicle) -> Vehicle:
    """The vehicle with a channel for forces from outside in each of its degrees of freedom."""
    names = tuple(f"tau_{'XYZKMN'[i]}" for i in vehicle.dof_indices)
    return replace(vehicle, force_channels=names)
