"""What stretches of a log tell of a vehicle's parameters, by equation of motion, and which tell most."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import islice

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import free_parameters
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array


@dataclass(frozen=True)
class InformationSettings:
    """Numbers by which information is counted."""

    together: int = 20  # stretches whose regressor is computed in one call
    bytes: int = 200_000_000  # that the information of all stretches may take
    # Directions of which all stretches together know less than this share of what they know of the best one
    # (columns scaled to alike size) are not determined by the logs, and do not count.
    known: float = 1e-9
    # Information that is there before any stretch is chosen, as a share of that of all: the logarithm has to
    # begin somewhere.
    before: float = 1e-6


SETTINGS = InformationSettings()


class Regressor:
    """The weak form's regressor of a vehicle: derivatives of its residual in the parameters."""

    def __init__(self, vehicle: Vehicle) -> None:
        names = free_parameters(vehicle) or vehicle.parameter_names
        self._vehicle, self._model = vehicle, WeakModel(Functions(vehicle), names)
        self.names, self._p = self._model.free, self._model.started({})
        self.equations = len(vehicle.dof_indices)

    def most_stretches(self) -> int:
        """How many stretches' information memory is meant for."""
        return int(SETTINGS.bytes // (8 * self.equations * max(len(self.names), 1) ** 2))

    def information(self, runs: Iterator[Run]) -> Array:
        """A^T A of every run by equation of motion, shape (runs, equations, parameters, parameters).

        A stretch in which nothing can be computed tells nothing.
        """
        found = []
        while group := list(islice(runs, SETTINGS.together)):
            found.append(self._of(group))
        return np.concatenate(found)

    def _of(self, runs: Sequence[Run]) -> Array:
        count = len(self.names)
        found = np.zeros((len(runs), self.equations, count, count))
        try:
            moving = [velocities_from_pose(run, self._vehicle.degrees_of_freedom) for run in runs]
            data = prepare(moving, self._vehicle, np.ones(2 * self.equations))
            # A model keeps what it computed of all data that it has seen.
            parts = self._model.knowing({}).linearise(data, self._p)
        except UndertowError:
            if len(runs) == 1:
                return found
            return np.concatenate([self._of([run]) for run in runs])
        for part, segment in zip(parts, data.segments, strict=True):
            table = part.J.reshape(-1, len(data.rows), count)[:, : self.equations]
            if np.isfinite(table).all():
                found[segment.run] += np.einsum("kei,kej->eij", table, table)
        return found


@dataclass(frozen=True)
class Choice:
    """Stretches in the order in which they were chosen."""

    places: list[int]
    gain: Array  # (chosen, equations) what each adds to the log determinant
    # (equations,) what those chosen know, as a share of what all do: the geometric mean over the directions
    # in which the parameters can differ; 1 where an equation has none.
    held: Array
    whole: float  # the same over all equations


def most_informative(information: Array, samples: Sequence[int], budget: int) -> Choice:
    """Choose stretches so that the determinant of the information grows most, equation by equation.

    The sum over the equations of log det(A^T A) is submodular: taking what adds most for a sample, again and
    again, comes close to the best choice there is, and what a stretch adds only falls as others are taken, so
    that most need not be looked at again. `information` is of every stretch and equation, shape (S, E, n, n);
    `budget` is how many samples all those chosen may have.
    """
    parts = [_as_shares(information[:, e]) for e in range(information.shape[1])]
    state = [SETTINGS.before * np.eye(part.shape[1]) for part in parts]
    gains, order, left = [], [], budget

    def gain(k: int) -> Array:
        pairs = zip(state, parts, strict=True)
        return np.array([_log_det(now + part[k]) - _log_det(now) for now, part in pairs])

    heap = [(-np.inf, k) for k in range(len(samples))]
    while heap:
        _, best = heappop(heap)
        if samples[best] > left:
            continue
        adds = gain(best)
        now = -float(adds.sum()) / samples[best]
        if heap and now > heap[0][0]:  # another one may add more
            heappush(heap, (now, best))
            continue
        order.append(best)
        gains.append(adds)
        left -= samples[best]
        state = [s + part[best] for s, part in zip(state, parts, strict=True)]
    return _choice(order, np.array(gains).reshape(len(order), len(parts)), state)


def _choice(order: list[int], gain: Array, state: list[Array]) -> Choice:
    size = np.array([len(s) for s in state])
    known = np.array([_log_det(s) for s in state])
    # Of the directions that nothing has told of, only what was there before counts.
    held = np.exp(known / np.maximum(size, 1))
    whole = float(np.exp(known.sum() / max(size.sum(), 1)))
    return Choice(order, gain, np.minimum(held, 1.0), min(whole, 1.0))


def _as_shares(information: Array) -> Array:
    """Information (S, n, n) in directions (S, d, d) in which that of all stretches is one."""
    total = information.sum(axis=0)
    size = np.sqrt(np.diag(total))
    used = np.flatnonzero(size > 0)
    scale = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh((total / np.outer(scale, scale))[np.ix_(used, used)])
    kept = values > SETTINGS.known * np.max(values, initial=0.0)
    basis = vectors[:, kept] / np.sqrt(values[kept]) / scale[used, None]
    return np.asarray(basis.T @ information[:, used[:, None], used] @ basis)


def _log_det(matrix: Array) -> float:
    return float(np.linalg.slogdet(matrix)[1]) if len(matrix) else 0.0
