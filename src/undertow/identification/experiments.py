"""Logs of a rig that holds or moves some motions: an experiment for each set that is free, put together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undertow.errors import UndertowError, listed
from undertow.identification.logs.run import Run
from undertow.model.symbols import DOFS, FORCE, POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .diagnose import DiagnosisResult, roles, save_found
from .diagnosis.result import Role, RunInfo
from .estimation.data import inverse_of
from .estimation.fitted import SURE, Fitted
from .estimation.step import estimated, follower_errors, followers

if TYPE_CHECKING:
    from .api import Refit

# What of the motion of a rig the equations may feel: depth and attitude, and all velocities.
_FELT = dict(zip(DOFS, zip((None, None, *POSE[2:]), VELOCITY, strict=True), strict=True))


@dataclass(frozen=True)
class Experiment:
    """Logs in which the same motions are free."""

    vehicle: Vehicle  # the vehicle with these motions only
    moved: tuple[str, ...]  # channels of motions that the rig moves as the log says
    held: tuple[str, ...]  # motions of the whole vehicle that are at rest
    pushed: bool  # whether the rig drives what is free; else the vehicle's own actuators do
    # train, test: logs to fit to and to judge by
    train: list[Run] = field(default_factory=list)
    test: list[Run] = field(default_factory=list)

    @property
    def name(self) -> str:
        """A name of its own for files: what is free, what is moved, and whether forces are given."""
        return "-".join([*self.vehicle.degrees_of_freedom, *self.moved, *(["forced"] if self.pushed else [])])

    def __str__(self) -> str:
        logs = ", ".join(run.name for run in (*self.train, *self.test))
        parts = [f"{listed(self.vehicle.degrees_of_freedom)} free"]
        parts += [f"{listed(self.held)} held at rest"] if self.held else []
        parts += [f"{listed(self.moved)} as logged"] if self.moved else []
        parts += ["driven by external forces"] if self.pushed else []
        return f"{'; '.join(parts)} ({logs})"


def on_rig(vehicle: Vehicle, runs: Sequence[Run]) -> bool:
    """Whether a rig holds or moves a motion of the vehicle in any of the logs."""
    return any(set(run.held) & set(vehicle.degrees_of_freedom) for run in runs)


def experiments(vehicle: Vehicle, runs: Sequence[Run], validation: Sequence[Run] = ()) -> list[Experiment]:
    """Sort the logs by what is free in them."""
    found: dict[tuple[object, ...], Experiment] = {}
    for role, logs in (("train", runs), ("test", validation)):
        for run in logs:
            one = _experiment(vehicle, run)
            key = (one.vehicle.degrees_of_freedom, one.moved, one.pushed)
            getattr(found.setdefault(key, one), role).append(run)
    for one in found.values():
        if not one.train:
            raise UndertowError(
                f"no log to fit to has the free motions of this validation log: {one}: leave it out"
            )
    return list(found.values())


def _experiment(vehicle: Vehicle, run: Run) -> Experiment:
    held = [d for d in vehicle.degrees_of_freedom if d in run.held]
    free = [d for d in vehicle.degrees_of_freedom if d not in run.held]
    if not free:
        raise UndertowError(
            f"run '{run.name}' has no free motion of '{vehicle.name}': held are {', '.join(held)}: "
            "leave the log out, or add its motion to the vehicle"
        )
    moved = {d: [n for n in _FELT[d] if n and run.has(n)] for d in held}
    channels = tuple(n for names in moved.values() for n in names)
    pushed = bool(held) and _pushed(vehicle, free, run)
    reduced = vehicle.constrained(free, channels, pushed=pushed) if held else vehicle
    still = tuple(d for d in held if not moved[d])
    return Experiment(reduced, channels, still, pushed)


def _pushed(vehicle: Vehicle, free: Sequence[str], run: Run) -> bool:
    """Whether the log has the forces on all that is free, in place of commands."""
    forces = [f"tau_{FORCE[DOFS.index(d)]}" for d in free]
    commands = [n for n in vehicle.actuator_names if not run.has(n)]
    lacking = [n for n in forces if not run.has(n)]
    if lacking and (commands or not vehicle.actuator_names):
        without = f"the commands {', '.join(commands)} nor " if commands else ""
        raise UndertowError(
            f"run '{run.name}' has neither {without}the forces {', '.join(lacking)} of what is free "
            f"({', '.join(free)}): map their columns"
        )
    return not lacking and bool(commands or not vehicle.actuator_names)


# --- put together ---------------------------------------------------------------------------------
@dataclass(frozen=True)
class Together:
    """Fits of several experiments as one, by how well each knows its parameters."""

    stated: Vehicle  # the whole vehicle as given
    fits: tuple[Fitted, ...]  # a fit for each experiment
    logs: Sequence[tuple[Role, Run | RunInfo]]  # what they were fitted to and judged by
    shares: Sequence[tuple[float, float]]  # the error of each experiment on validation data before and after

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameters that any experiment fitted."""
        return tuple(dict.fromkeys(n for fit in self.fits for n in fit.vehicle_covariance[0]))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of their errors: experiments are independent, so what they know adds up."""
        return inverse_of(np.sum([self._known(fit)[0] for fit in self.fits], axis=0))

    @cached_property
    def values(self) -> dict[str, float]:
        """Values by generalised least squares, in SI and SNAME signs."""
        found = self.covariance @ np.sum([self._known(fit)[1] for fit in self.fits], axis=0)
        return dict(zip(self.names, found.tolist(), strict=True))

    def _known(self, fit: Fitted) -> tuple[Array, Array]:
        """Information of a fit, (k, k), and that times its values, (k,), in the order of `names`."""
        own, covariance = fit.vehicle_covariance
        places = np.array([self.names.index(n) for n in own])
        table, pull = np.zeros((len(self.names), len(self.names))), np.zeros(len(self.names))
        information = inverse_of(covariance)
        table[np.ix_(places, places)] = information
        pull[places] = information @ np.array([fit.values[n] for n in own])
        return table, pull

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors of the values."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def vehicle(self) -> Vehicle:
        """The whole vehicle with the values of all experiments."""
        values, errors = self.values, self.errors
        for fit in self.fits:
            own = {n: self.values[n] for n in fit.vehicle_covariance[0]}
            values = values | followers(fit.model, own)
            errors = errors | follower_errors(fit.model, {n: self.errors[n] for n in own})
        return estimated(self.stated, values, errors)

    def save(self, template: str | Path, out: Path, command: str, **more: object) -> None:
        """Write the whole vehicle, in the form of its file; errors are root mean squares."""
        before, after = np.sqrt(np.mean(np.square(self.shares), axis=0)).tolist()
        known = self.names, self.covariance, ()
        save_found(self.vehicle, template, out, command, self.logs, (before, after), known, **more)

    def disagreements(self) -> Iterator[str]:
        """Parameters of which two experiments say what the other's errors do not allow."""
        for one, other in combinations(self.fits, 2):
            for name in (n for n in one.values if n in other.values):
                apart = abs(one.values[name] - other.values[name])
                spread = float(np.hypot(one.standard_errors[name], other.standard_errors[name]))
                if apart > SURE * spread:
                    places = [listed(f.model.functions.vehicle.degrees_of_freedom) for f in (one, other)]
                    yield (
                        f"{name} is {one.values[name]:.4g} by {places[0]} and {other.values[name]:.4g} by "
                        f"{places[1]} (SNAME signs), {apart / spread:.1f} standard errors apart: one of them "
                        "lacks an effect"
                    )


def refitted(vehicle: Vehicle, fits: Sequence[Refit]) -> Together:
    """The whole vehicle by the fits of its experiments."""
    logs = [pair for one in fits for pair in roles(one.train, one.test)]
    return Together(vehicle, tuple(one.fit for one in fits), logs, [one.errors for one in fits])


def diagnosed(vehicle: Vehicle, outcomes: Sequence[DiagnosisResult]) -> Together:
    """The whole vehicle with the effects that are named in any of its experiments."""
    for outcome in outcomes:
        for effect in (e for e in outcome.after.effects if e.id in outcome.effects):
            new = {n: v for n, v in outcome.after.values.items() if n not in vehicle.values}
            vehicle = vehicle.with_effect(type(effect), new)
    logs = [(r.role, r) for outcome in outcomes for r in outcome.diagnosis.runs]
    errors = [(d.steps[0].error, d.last_step.error) for d in (outcome.diagnosis for outcome in outcomes)]
    return Together(vehicle, tuple(outcome.fit for outcome in outcomes), logs, errors)
