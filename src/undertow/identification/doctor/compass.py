"""Deviation of a compass: velocities turned by the heading drift sideways by an angle that the heading sets.

A hull has no way of knowing north. Sideways velocity in proportion to the speed ahead, by a factor that goes
with the sine and cosine of the heading, is therefore an error of the heading with which the velocities were
turned into body axes: the semicircular deviation of iron and currents near the compass (coefficients B and C;
Bowditch, The American Practical Navigator, chapter on compass error). Current and wind move a vehicle
sideways by its heading as well, but do so at rest; they have terms of their own in every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.findings import Finding, percent
from undertow.identification.logs.mapping import Edit, Edits, LogMapping, as_toml
from undertow.identification.logs.run import Run, without_deviation
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Index

from .mistakes import Undo


@dataclass(frozen=True)
class CompassSettings:
    """Thresholds beyond which the drift angle shows a deviation of the compass."""

    samples: int = 2000  # of a run that are looked at
    pieces: int = 32  # into which the logs are cut, about: neighbouring samples are not independent
    # Share of a term that current, wind, turning and commands may not imitate: at a constant speed a current
    # does the same as a deviation, and a speed that varies by a seventh leaves this much.
    distinct: float = 0.02
    certain: float = 6.0  # standard errors
    # Standard error in any direction, as a share of the deviation, beyond which the headings of the logs do
    # not tell it from a sensor that is turned.
    vague: float = 0.5
    smallest: float = 0.035  # rad: a compass that has been adjusted is better than 2 degrees
    # rad: the compass of a ship of steel is off by half of this before it is adjusted, and of more the sine
    # of an angle is no longer the angle. What seems larger is a force that depends on the heading.
    largest: float = 0.5
    # Cosine between what the heading does at rest and what grows with the speed from which one takes away
    # from the other.
    opposed: float = 0.5
    explains: float = 0.25  # share of what is left of the sideways velocity, in pieces that were not fitted


SETTINGS = CompassSettings()


@dataclass(frozen=True)
class Deviation:
    """What has to be added to a heading: B sin psi + C cos psi."""

    value: Array  # (2,) B and C, rad
    covariance: Array  # (2, 2)
    explained: float  # share of the sideways velocity in pieces that were not fitted
    derived: bool  # whether the velocities were derived from the pose, and follow it

    @property
    def error(self) -> Array:
        """Standard errors of B and C, rad."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def is_certain(self) -> bool:
        """Whether it is too large for a compass that has been adjusted, and for chance, but not for any."""
        errors = float(self.value @ np.linalg.pinv(self.covariance, hermitian=True) @ self.value) ** 0.5
        size = float(np.hypot(*self.value))
        possible = SETTINGS.smallest < size < SETTINGS.largest
        vague = float(np.linalg.eigvalsh(self.covariance)[-1]) ** 0.5 > SETTINGS.vague * size
        return possible and not vague and errors > SETTINGS.certain and self.explained > SETTINGS.explains

    @property
    def undo(self) -> Undo:
        """Takes a run with the deviation and returns it as it would be without."""
        b, c = map(float, self.value)
        return lambda run: without_deviation(run, (0.0, b, c), velocities=not self.derived)

    def edits(self, mapping: LogMapping) -> Edits:
        """What the mapping file has to say; velocities along the earth are turned by the heading anyway."""
        given = mapping.compass
        so_far = given.coefficients[1:] if given else (0.0, 0.0)
        degrees = np.degrees(self.value + so_far)
        found = [Edit("compass", n, f"{d:.3g} deg") for n, d in zip("BC", degrees, strict=True)]
        turned = mapping.frames.velocity == "body" and not self.derived
        return (*found, Edit("compass", "velocities", True)) if turned else tuple(found)

    def finding(self, mapping: LogMapping) -> Finding:
        """The deviation in words and numbers."""
        b, c = (f"{v:.3g} ± {e:.1g}" for v, e in np.degrees([self.value, self.error]).T)
        return Finding(
            id="compass_deviation",
            severity="mistake",
            text="the heading has a deviation that changes with it, as iron or currents near a compass "
            f"make: moving ahead, the vehicle drifts sideways by B sin psi + C cos psi, B = {b} deg, "
            f"C = {c} deg, which explains {percent(self.explained)} of the sideways velocity that turning, "
            "commands, current and wind leave (mean square, in parts of the logs that were not fitted)",
            evidence={
                "B": float(self.value[0]),
                "C": float(self.value[1]),
                "B_error": float(self.error[0]),
                "C_error": float(self.error[1]),
                "explained": self.explained,
            },
            mapping=as_toml(self.edits(mapping)),
        )


def deviation(vehicle: Vehicle, runs: Sequence[Run]) -> Deviation | None:
    """The deviation of the compass by which velocities were turned; None where none is sure."""
    usable = [run for run in runs if all(run.has(n) for n in ("psi", "u", "v"))]
    parts = [_part(run, vehicle) for run in usable]
    parts = [part for part in parts if len(part.v)]
    if not parts:
        return None
    pieces = max(2, round(SETTINGS.pieces / len(parts)))
    piece = np.concatenate([i * pieces + part.pieces(pieces) for i, part in enumerate(parts)])
    given = np.concatenate([part.turned for part in parts])
    residual = _regressed(
        _other_terms(parts), np.column_stack([np.concatenate([part.v for part in parts]), given])
    )
    own = np.sum(residual[:, 1:] ** 2, axis=0) / np.maximum(np.sum(given**2, axis=0), 1e-300)
    if np.min(own) < SETTINGS.distinct:
        return None
    fitted = _clustered(residual[:, 1:], residual[:, 0], piece)
    explained = _explained_elsewhere(residual[:, 1:], residual[:, 0], piece)
    found = Deviation(*fitted, explained, all("v" in run.derived for run in usable))
    return None if not found.is_certain or _is_wind(parts, found) else found


@dataclass(frozen=True)
class _Part:
    """Samples of a run: sideways velocity, speed, heading, and what else moves the vehicle sideways."""

    v: Array
    u: Array
    psi: Array
    other: Array  # (n, k) the rate of turn and the commands, which act alike in all runs

    @property
    def turned(self) -> Array:
        """Sideways velocity for one radian of B and of C, (n, 2)."""
        return self.u[:, None] * np.column_stack([np.sin(self.psi), np.cos(self.psi)])

    @property
    def drift(self) -> Array:
        """What current and wind do, which differs from run to run, and a constant error of v."""
        return np.column_stack([np.sin(self.psi), np.cos(self.psi), np.ones_like(self.psi)])

    @property
    def common_terms(self) -> Array:
        """What else acts alike in all runs: an asymmetric hull, a sensor turned or away from the origin."""
        terms = [self.u, np.abs(self.u)]
        return np.column_stack([*terms, self.other, self.other * self.u[:, None]])

    def pieces(self, count: int) -> Index:
        """The number of the piece that each sample is in."""
        return np.arange(len(self.v)) * count // max(len(self.v), 1)


def _part(run: Run, vehicle: Vehicle) -> _Part:
    own = [n for n in vehicle.command_names if n not in vehicle.inputs and run.has(n)]
    names = ["v", "u", "psi", *(["r"] if run.has("r") else []), *own]
    table = run.matrix(names)
    there = np.flatnonzero(np.isfinite(table).all(axis=1))
    table = table[there[:: max(1, -(-len(there) // SETTINGS.samples))]]
    return _Part(table[:, 0], table[:, 1], table[:, 2], table[:, 3:])


def _other_terms(parts: Sequence[_Part]) -> Array:
    """All other terms, (n, k): those that are alike in all runs, then those of each run."""
    ends = np.cumsum([len(part.v) for part in parts])
    of_runs = np.zeros((ends[-1], 3 * len(parts)))
    for i, (part, end) in enumerate(zip(parts, ends, strict=True)):
        of_runs[end - len(part.v) : end, 3 * i : 3 * i + 3] = part.drift
    return np.hstack([np.concatenate([part.common_terms for part in parts]), of_runs])


def _regressed(terms: Array, table: Array) -> Array:
    """What other terms leave of the columns of a table."""
    size = np.linalg.norm(terms, axis=0)
    basis, values, _ = np.linalg.svd(terms[:, size > 0] / size[size > 0], full_matrices=False)
    basis = basis[:, values > 1e-6 * values[0]] if len(values) else basis
    return np.asarray(table - basis @ (basis.T @ table))


def _clustered(table: Array, target: Array, piece: Array) -> tuple[Array, Array]:
    """Least squares, and its covariance if pieces are independent of each other (sandwich estimator)."""
    inverse = np.linalg.pinv(table.T @ table, hermitian=True)
    value = inverse @ (table.T @ target)
    scores = table * (target - table @ value)[:, None]
    sums = np.array([scores[piece == k].sum(axis=0) for k in np.unique(piece)])
    return value, inverse @ (sums.T @ sums) @ inverse


def _explained_elsewhere(table: Array, target: Array, piece: Array) -> float:
    """Share of the target that is explained by what was fitted to all other pieces."""
    squares = table.T @ table, table.T @ target
    residual = 0.0
    for k in np.unique(piece):
        own, v = table[piece == k], target[piece == k]
        value = np.linalg.lstsq(squares[0] - own.T @ own, squares[1] - own.T @ v, rcond=None)[0]
        residual += float(np.sum((v - own @ value) ** 2))
    return 1.0 - residual / max(float(target @ target), 1e-300)


def _is_wind(parts: Sequence[_Part], found: Deviation) -> bool:
    """Whether the drift may be that of wind, which is felt less the faster a vehicle moves."""
    # What grows with the speed then takes away from what the same heading does at rest, and is less than
    # that.
    moved, at_rest, ahead = [], [], []
    for part in parts:
        drift = part.turned @ found.value
        # Where a run keeps its heading, sine, cosine and constant are one and the same.
        rest = np.linalg.lstsq(part.drift, part.v - drift, rcond=SETTINGS.distinct**0.5)[0]
        moved.append(drift)
        at_rest.append(part.drift @ rest)
        ahead.append(np.sign(part.u))
    with_speed, without = np.concatenate(moved), np.concatenate(at_rest)
    opposed = -float(np.concatenate(ahead) * with_speed @ without)
    sizes = float(np.linalg.norm(with_speed)), float(np.linalg.norm(without))
    return sizes[0] < sizes[1] and opposed > SETTINGS.opposed * sizes[0] * sizes[1]
