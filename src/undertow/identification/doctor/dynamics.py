"""How well a model explains logs, quickly, and how much better it would with something changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from ..logs.run import POSE, VELOCITY
from ..weak.data import Segment, WeakData, prepare
from ..weak.disturbance import mean_square
from ..weak.fit import WeakFit, fit_weak, free_parameters
from ..weak.residual import Linearised, whitened
from ..weak.step import inverse_of, normal_equations, prior_of
from .kinematics import jacobian, liveliest
from .mistake import Undo, with_channels

# Samples that are looked at, all runs together, in three and in six degrees of freedom.
_MOST, _MOST_OF_MANY = 1600, 600
_MANY = 4
# Mean square, in units of the noise, beyond which a model that was refitted does not explain its log.
_UNEXPLAINED = 2.0
# Undoing a mistake must take this factor off what an equation leaves beyond the noise: less is enough where
# noise is all that remains, since a feedback loop, too, makes a model with a wrong sign look better.
DECISIVE, ENOUGH = 10.0, 4.0
# Spread of a velocity over its noise from which its equation of motion is a witness.
_MOVED = 5.0
# No other equation may get worse by more than this factor.
_WORSE = 1.25
# Change of a channel's spread that only another unit explains.
_UNIT = 5.0
# Excess over the noise that cannot be told from none.
_SMALL = 0.5


@dataclass(frozen=True)
class Dynamics:
    """A vehicle's model on logs, refitted.

    Attributes
    ----------
    vehicle : Vehicle
        The model.
    runs : list of Run
        The part of the logs that is looked at.
    data : WeakData
        The same, prepared.
    fit : WeakFit
        The fit, under a noise model that takes what the model does not explain for a disturbance.
    quiet : (n,) array
        Mean square of what it leaves of each equation of motion, in units of the sensors' noise.
    """

    vehicle: Vehicle
    runs: list[Run]
    data: WeakData
    fit: WeakFit
    quiet: Array

    @property
    def unexplained(self) -> bool:
        """Whether the logs say that something is wrong with the model, or with how they are read."""
        return bool(np.any(self.quiet > _UNEXPLAINED))

    def promised(self, undo: Undo) -> float | None:
        """Factor by which one Gauss-Newton step from the file's values would explain the motion better once a
        mistake is undone; geometric mean over the equations of motion. None where it cannot be tried.
        """
        data = self.undone(undo)
        if data is None:
            return None
        model, size = self.fit.model, len(self.quiet)
        p = np.array([self.vehicle.value_of(n).value for n in self.vehicle.parameter_names], dtype=float)
        at = whitened(model.linearise(data, p), self.fit.whitening)
        step = _free_step(at, p[list(model.places)], prior_of(model))
        after = mean_square(at.r + at.J @ step, data)[:size]
        return float(np.exp(np.mean(np.log(self.fit.mean_square()[:size] / np.maximum(after, 1e-12)))))

    def refitted(
        self, vehicle: Vehicle | None = None, undo: Undo | None = None, free: Sequence[str] = ()
    ) -> WeakFit | None:
        """The fit with something changed, under the same noise model; None where it cannot be made.

        Parameters
        ----------
        vehicle : Vehicle, optional
            Another model.
        undo : callable, optional
            Applied to every run.
        free : sequence of str
            Parameters that are fitted besides those that the vehicle marks.
        """
        data = self.data if undo is None else self.undone(undo)
        if data is None:
            return None
        model = vehicle or self.vehicle
        names = (*free_parameters(model), *free)
        noise = {"whitening": self.fit.whitening, "disturbance": self.fit.disturbance}
        try:
            return fit_weak(model, data, names, **noise)  # type: ignore[arg-type]
        except (UndertowError, np.linalg.LinAlgError):
            return None

    def undone(self, undo: Undo) -> WeakData | None:
        """The data with a mistake undone in every run; None where samples would go missing."""
        runs = tuple(rederived(run, undo) for run in self.runs)
        segments = tuple(self._segment(runs[s.run], s) for s in self.data.segments)
        if not all(np.isfinite(s.measured).all() and np.isfinite(s.u).all() for s in segments):
            return None
        before, after = (np.concatenate([s.measured for s in of]) for of in (self.data.segments, segments))
        sigma = self.data.sigma * _other_unit(np.std(before, axis=0), np.std(after, axis=0))
        return replace(self.data, runs=runs, segments=segments, sigma=sigma)

    def _segment(self, run: Run, s: Segment) -> Segment:
        zero = np.zeros(len(run.t))
        measured = [run.channels.get(n, zero)[s.samples] for n in self.data.names]
        commands = run.matrix(self.data.commands)[s.samples]
        return replace(s, measured=np.column_stack(measured), u=commands)

    def gain(self, fit: WeakFit) -> Gain:
        """What a changed fit is better by."""
        return Gain(self.quiet, quiet_mean_square(fit)[: len(self.quiet)], self._moved)

    @property
    def _moved(self) -> NDArray[np.bool_]:
        size = len(self.quiet)
        spread = np.std(np.concatenate([s.measured[:, size:] for s in self.data.segments]), axis=0)
        return np.asarray(spread > _MOVED * self.data.sigma[size:])


@dataclass(frozen=True)
class Gain:
    """What a refitted model leaves of each equation of motion, before and after a change.

    Attributes
    ----------
    before, after : (n,) arrays
        Mean squares in units of the sensors' noise.
    moved : (n,) bool array
        Whether the velocity stands out of its noise.
    """

    before: Array
    after: Array
    moved: NDArray[np.bool_]

    @property
    def factors(self) -> Array:
        """How many times what exceeds the noise is smaller after the change, (n,)."""
        excess = [np.maximum(a - 1.0, _SMALL) for a in (self.before, self.after)]
        return np.asarray(excess[0] / excess[1])

    @property
    def overall(self) -> float:
        """Geometric mean of the factors."""
        return float(np.exp(np.mean(np.log(self.factors))))

    @property
    def explained(self) -> bool:
        """Whether little more than noise is left after the change."""
        return bool(np.all(self.after < _UNEXPLAINED))

    @property
    def decisive(self) -> bool:
        """Whether the change explains at least one equation of motion and spoils none."""
        needed = ENOUGH if self.explained else DECISIVE
        wrong = (self.before > _UNEXPLAINED) & self.moved
        return bool(np.any(self.factors[wrong] >= needed) and np.all(self.factors > 1.0 / _WORSE))


def quiet_mean_square(fit: WeakFit) -> Array:
    """Mean square of what a fit leaves of every equation, in units of the sensors' noise, (2n,)."""
    quiet = fit.model.whitening(fit.data, fit.p)
    return mean_square(whitened(fit.model.linearise(fit.data, fit.p), quiet).r, fit.data)


def _free_step(at: Linearised, now: Array, prior: tuple[Array, Array]) -> Array:
    """Least-squares step without bounds, which would cost more than all the rest of a first look."""
    gram, slope = normal_equations(at, now, prior)
    return -inverse_of(gram) @ slope


def _other_unit(before: Array, after: Array) -> Array:
    """Factors of the noise where a channel is in another unit now: what is smaller is not better for that."""
    ratio = after / np.where(before > 0, before, np.inf)
    return np.where((ratio > 0) & ((ratio < 1 / _UNIT) | (ratio > _UNIT)), ratio, 1.0)


def dynamics_of(vehicle: Vehicle, runs: Sequence[Run]) -> Dynamics | None:
    """Fit a vehicle to the liveliest part of logs; None where they are too short or hold no motion.

    Parameters
    ----------
    vehicle : Vehicle
        The model; parameters marked `estimate` are refitted.
    runs : sequence of Run
        Logs with its velocities and commands.
    """
    most = _MOST if len(vehicle.dof_indices) <= _MANY else _MOST_OF_MANY
    try:
        parts = [_part(run, vehicle, most // len(runs)) for run in runs]
        data = prepare(parts, vehicle)
        fit = fit_weak(vehicle, data)
    except (UndertowError, np.linalg.LinAlgError):
        return None
    return Dynamics(vehicle, parts, data, fit, quiet_mean_square(fit)[: len(vehicle.dof_indices)])


def _part(run: Run, vehicle: Vehicle, most: int) -> Run:
    piece = liveliest(run, vehicle.velocity_names, most)
    return run.slice(float(run.t[piece.start]), float(run.t[piece.stop - 1]))


def rederived(run: Run, undo: Undo) -> Run:
    """Undo a mistake in a run; velocities that were derived from its pose follow the pose that is undone."""
    after = undo(run)
    if not run.derived:
        return after
    places = [VELOCITY.index(n) for n in run.derived]
    pose = _six(run, POSE)
    rate = np.einsum("nij,nj->ni", jacobian(pose), _six(run, VELOCITY))
    # Mistakes are affine in the pose, so that this difference is exact.
    plain = replace(run, wrapped={})
    moved = with_channels(plain, {n: run.channels[n] + rate[:, POSE.index(n)] for n in POSE if run.has(n)})
    before, later = (_six(undo(r), POSE) for r in (plain, moved))
    # The clock may be another one, too.
    slower = (after.t[-1] - after.t[0]) / (run.t[-1] - run.t[0])
    velocity = np.linalg.solve(jacobian(before), (later - before)[..., None]) / slower
    new = {VELOCITY[i]: np.asarray(velocity[:, i, 0]) for i in places}
    spread = [np.array([np.nanstd(of[n]) for n in new]) for of in (run.channels, new)]
    noise = zip(new, _other_unit(*spread), strict=True)
    sigma = {n: factor * run.sigma[n] for n, factor in noise if n in run.sigma}
    return replace(with_channels(after, new), sigma={**run.sigma, **sigma})


def _six(run: Run, names: tuple[str, ...]) -> Array:
    zero = np.zeros(len(run.t))
    return np.column_stack([run.channels.get(n, zero) for n in names])
