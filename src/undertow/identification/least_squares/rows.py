"""The regression at the samples of a log, generated from the model and reduced to few rows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.typing import Array

from ..logs import Run
from ..triangle import Triangle
from ..weak.fit import free_parameters
from .axis import Axis, known_states
from .cases import Case, Edges
from .linear_fit import LinearFit

# Share of the sampling interval by which the clock may waver for a filter that counts samples.
_EVEN = 0.02


class Regression:
    """The regressor of one motion.

    Parameters
    ----------
    axis : Axis
        The motion.

    Raises
    ------
    UndertowError
        If nothing is to be estimated, a parameter is not linear, an effect has states of its own, or the
        thrust comes late.
    """

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.functions = Functions(axis.vehicle)
        vehicle = axis.vehicle
        known_states(vehicle, self.functions.state_names, (*vehicle.pose_names, *vehicle.velocity_names))
        _no_dead_time(axis, self.functions)
        self.free = free_parameters(vehicle)
        _must_be_linear(axis, self.free)
        self._fit = LinearFit(self.functions, self.free)
        self._places = [self.functions.parameter_names.index(n) for n in self.free]

    def take(self, triangle: Triangle, run: Run, case: Case, edges: Edges) -> None:
        """Take in a run whose velocity and acceleration are smoothed as a case says."""
        pieces = self._pieces(run, case, edges)
        if not pieces:
            raise UndertowError(self._short(run, case, edges))
        self._take(triangle, run, pieces, case, edges)

    def take_between(
        self, triangle: Triangle, run: Run, case: Case, edges: Edges, after: float, until: float
    ) -> None:
        """The same of a part of a log, which may have no stretch that is long enough: after < t <= until."""
        self._take(triangle, run, self._pieces(run, case, edges), case, edges, after, until)

    def _take(
        self,
        triangle: Triangle,
        run: Run,
        pieces: list[slice],
        case: Case,
        edges: Edges,
        after: float = -np.inf,
        until: float = np.inf,
    ) -> None:
        for piece in pieces:
            samples = self._samples(run, piece, case, edges)
            # Times do not go back: what is kept is one stretch.
            first, last = np.searchsorted(run.t[piece], (after, until), side="right")
            kept = {name: column[first:last] for name, column in samples.items()}
            triangle.add(*self._fit.triangle(kept))

    def _samples(self, run: Run, piece: slice, case: Case, edges: Edges) -> dict[str, Array]:
        """Columns of a stretch; NaN where a filter gives nothing."""
        t = run.t[piece]
        logged = run.channels[self.axis.rate][piece] if run.has(self.axis.rate) else None
        step = _step(run, piece, even=case.counts_samples(logged=logged is not None))
        velocity, rate = case.smoothed(run.channels[self.axis.velocity][piece], logged, step, edges)
        pose = {self._pose: run.channels[self._pose][piece]} if self._feels_pose else {}
        commands = {name: run.channels[name][piece] for name in self.axis.vehicle.command_names}
        # A model may do without one of them; a sample counts only if both are known.
        used = np.isfinite(velocity) & np.isfinite(rate)
        motion = {
            self.axis.velocity: np.where(used, velocity, np.nan),
            self.axis.rate: np.where(used, rate, np.nan),
        }
        return {"t": t, **pose, **commands, **motion}

    def _pieces(self, run: Run, case: Case, edges: Edges) -> list[slice]:
        """Stretches without gaps that are long enough for the filters."""
        if self._feels_pose and not run.has(self._pose):
            raise UndertowError(
                f"run '{run.name}' has no channel '{self._pose}', which the {self.axis.motion} of "
                f"'{self.axis.vehicle.name}' depends on: name its column in a mapping file (--map)"
            )
        needed = case.needs(edges)
        return [p for p in run.segments(self._needed(run, case)) if p.stop - p.start >= needed]

    def _needed(self, run: Run, case: Case) -> list[str]:
        names = [self.axis.velocity, *self.axis.vehicle.command_names]
        names += [self._pose] if self._feels_pose else []
        return names + ([self.axis.rate] if run.has(self.axis.rate) and not case.differentiated else [])

    def _short(self, run: Run, case: Case, edges: Edges) -> str:
        return (
            f"run '{run.name}': no stretch without gaps in {', '.join(self._needed(run, case))} has the "
            f"{case.needs(edges)} samples that case {case.name} needs: fill the gaps, or choose other cases "
            "(--cases)"
        )

    @property
    def feels_time(self) -> bool:
        """Whether the equations contain the time itself."""
        return bool(ca.depends_on(self.functions.driven_residual, self.functions.t))

    @property
    def _pose(self) -> str:
        return self.axis.vehicle.pose_names[0]

    @cached_property
    def _feels_pose(self) -> bool:
        return bool(ca.depends_on(self.functions.driven_residual, self.functions.eta))

    @property
    def _still(self) -> Array:
        """Parameters with those that are sought at zero."""
        p = np.array(self.functions.values(), dtype=float)
        p[self._places] = 0.0
        return p

    def inertia(self, theta: Array, covariance: Array) -> tuple[float, float]:
        """Mass with added mass and its standard error at an estimate."""
        p = self._still
        p[self._places] = theta
        value, slope = (np.asarray(v, dtype=float) for v in self._mass(p))
        slope = slope[0, self._places]
        return float(value[0, 0]), float(np.sqrt(slope @ covariance @ slope))

    @cached_property
    def _mass(self) -> ca.Function:
        f = self.functions
        return ca.Function("mass", [f.p], [f.mass_matrix, ca.jacobian(f.mass_matrix, f.p)])

    @cached_property
    def inertial(self) -> tuple[str, ...]:
        """Sought parameters that are part of the inertia."""
        f = self.functions
        felt = ca.jacobian_sparsity(f.mass_matrix, f.p)
        places = set(felt.get_col())
        return tuple(n for n, k in zip(self.free, self._places, strict=True) if k in places)


def _must_be_linear(axis: Axis, free: Sequence[str]) -> None:
    declared = axis.vehicle.declared_parameters
    if not free:
        raise UndertowError(
            f"no parameter of the {axis.motion} of '{axis.vehicle.name}' is to be estimated: write, for "
            "instance, X_u = { value = ..., estimate = true }"
        )
    shaped = [n for n in free if not declared[n].linear]
    if shaped:
        raise UndertowError(
            f"{shaped[0]} does not enter the equations linearly, which least squares on samples needs: state "
            "it as known, or use undertow fit"
        )


def _step(run: Run, piece: slice, *, even: bool) -> float:
    steps = np.diff(run.t[piece])
    step = float(np.median(steps))
    if len(steps) and np.max(np.abs(steps - step)) <= _EVEN * step:
        # Of an even clock the mean is known better: late in a long log, times are rounded to 1e-10 s.
        step = float((run.t[piece][-1] - run.t[piece][0]) / len(steps))
    worst = float(np.max(np.abs(steps - step)))
    if even and worst > _EVEN * step:
        raise UndertowError(
            f"run '{run.name}' is sampled unevenly (steps of {step:g} s, off by up to {worst:g} s), but "
            "Savitzky-Golay filters count samples: resample it on an even clock, or use undertow fit"
        )
    return step


def _no_dead_time(axis: Axis, functions: Functions) -> None:
    seconds = float(functions.dead_time(functions.values()))
    if seconds:
        raise UndertowError(
            f"vehicle '{axis.vehicle.name}' answers its commands {seconds:g} s late, which least squares on "
            "samples does not follow: use undertow fit, or log the force itself"
        )
