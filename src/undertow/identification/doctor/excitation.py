"""What happened in every degree of freedom, and what therefore cannot be identified from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.model.symbols import FORCE
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from ..logs.run import UNITS
from ..weak.data import channel_noise
from .findings import Excited, Finding

_EXCITED = 3.0  # rms over noise below which a motion says nothing
_TENTH = 0.1
_OVER_NOISE = 3.0
_ONE_WAY = 0.05
_ALIKE = 0.985  # squared correlation of speed and its square beyond which drag laws cannot be told apart
_FEW_REVERSALS = 2
_HEADINGS = np.radians(60.0)


@dataclass(frozen=True)
class _Motion:
    """A velocity of all runs, its noise, the samples of a second, and where it moves."""

    parts: list[Array]
    noise: float
    rate: int

    @property
    def all(self) -> Array:
        data = np.concatenate(self.parts)
        return data[np.isfinite(data)]

    @property
    def threshold(self) -> float:
        return max(_OVER_NOISE * self.noise, _TENTH * float(np.quantile(np.abs(self.all), 0.98)))

    @property
    def means(self) -> Array:
        """Means over a second: in them, noise is smaller by the root of the number of samples."""
        whole = self.all[: len(self.all) // self.rate * self.rate]
        return np.asarray(whole.reshape(-1, self.rate).mean(axis=1))

    @property
    def noise_of_means(self) -> float:
        return float(self.noise / np.sqrt(self.rate))

    @property
    def moving(self) -> Array:
        return self.all[np.abs(self.all) > self.threshold]

    @property
    def reversals(self) -> int:
        """Changes of direction, of speeds that stand out only."""
        return sum(_sign_changes(part[np.abs(part) > self.threshold]) for part in self.parts)


def _sign_changes(values: Array) -> int:
    return int(np.sum(np.diff(np.sign(values)) != 0))


def excitation(vehicle: Vehicle, runs: Sequence[Run]) -> list[Excited]:
    """What happened in each degree of freedom.

    Parameters
    ----------
    vehicle : Vehicle
        Whose degrees of freedom and thrusters matter.
    runs : sequence of Run
        Logs with its velocities.
    """
    names = vehicle.velocity_names
    noise = channel_noise(runs, names)
    return [
        _excited(vehicle, i, _Motion([r.channels[n] for r in runs], float(noise[i]), _rate(runs)), runs)
        for i, n in enumerate(names)
    ]


def _rate(runs: Sequence[Run]) -> int:
    """Samples of a second, at least one, and no more than a tenth of the shortest log has."""
    usual = 1.0 / float(np.median(np.diff(runs[0].t)))
    return int(np.clip(round(usual), 1, max(1, min(len(r.t) for r in runs) // 10)))


def _excited(vehicle: Vehicle, place: int, motion: _Motion, runs: Sequence[Run]) -> Excited:
    name = vehicle.velocity_names[place]
    moving = motion.moving
    span = _command_range(vehicle, vehicle.dof_indices[place], runs)
    return Excited(
        degree_of_freedom=vehicle.degrees_of_freedom[place],
        velocity=name,
        unit=UNITS[name],
        rms=float(np.sqrt(np.mean(motion.all**2))) if len(motion.all) else 0.0,
        noise=motion.noise,
        moving=len(moving) / max(len(motion.all), 1),
        positive=float(np.mean(moving > 0)) if len(moving) else 0.0,
        reversals=motion.reversals,
        command_range=span,
        cannot=list(_cannot(motion)),
    )


def _command_range(vehicle: Vehicle, row: int, runs: Sequence[Run]) -> float | None:
    """Span of the commanded force over the largest span that limits allow."""
    gains = {t.name: t.wrench[row] * t.thrust_per_command.value for t in vehicle.thrusters if t.wrench[row]}
    limits = {t.name: t.limit for t in vehicle.thrusters}
    largest = sum(abs(g) * (limits[n] or np.inf) for n, g in gains.items())
    if not gains or not np.isfinite(largest):
        return None
    force = np.concatenate([sum(g * r.channels[n] for n, g in gains.items()) for r in runs])
    return float((np.nanmax(force) - np.nanmin(force)) / (2 * largest))


def _cannot(motion: _Motion) -> Iterator[str]:
    moving, means, noise = motion.moving, motion.means, motion.noise_of_means
    if not len(moving) or not len(means) or np.sqrt(np.mean(means**2)) < _EXCITED * noise:
        yield "anything: the motion does not stand out of its noise"
        return
    if np.std(means) < _EXCITED * noise:
        yield "added mass (the velocity hardly changes)"
    if min(np.mean(moving > 0), np.mean(moving < 0)) < _ONE_WAY:
        yield "drag in the other direction"
    speed = np.abs(moving)
    if _alike(speed):
        yield "linear and quadratic drag apart (one speed only)"
    if motion.reversals < _FEW_REVERSALS:
        yield "dead band and dry friction (hardly a reversal)"


def _alike(speed: Array) -> bool:
    """Whether a straight line through zero explains the square of the speed."""
    square = speed**2
    left = square - speed * (speed @ square) / (speed @ speed)
    return bool(left @ left < (1 - _ALIKE) * (square @ square))


def findings(rows: Sequence[Excited], vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Degrees of freedom that were not moved, and what else the motion leaves open."""
    for row in rows:
        if row.cannot:
            dead = not _moved(row)
            yield Finding(
                id="excitation",
                severity="warning" if dead else "note",
                text=f"{row.degree_of_freedom} ({row.velocity}: rms {row.rms:.3g}, noise {row.noise:.2g} "
                f"{row.unit}; {row.reversals} reversals) cannot show {'; '.join(row.cannot)}",
                evidence={"rms": row.rms, "noise": row.noise, "reversals": float(row.reversals)},
            )
    yield from _headings(vehicle, runs)
    yield from _still_commands(rows, vehicle, runs)


def _still_commands(rows: Sequence[Excited], vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Commands that never change: nothing can be learned of them, and the column may be a wrong one."""
    still = {n for n in vehicle.command_names if all(_still(run.channels[n]) for run in runs)}
    if not still:
        return
    moving = [
        row.degree_of_freedom
        for row, place in zip(rows, vehicle.dof_indices, strict=True)
        if _moved(row) and (acting := _acting_on(vehicle, place)) and still.issuperset(acting)
    ]
    names = [n for n in vehicle.command_names if n in still]
    told = (
        f"what acts on {', '.join(moving)} stands still while the vehicle moves there, and the model can "
        "only blame something else"
        if moving
        else f"what {'they do' if len(names) > 1 else 'it does'} cannot be told from this log"
    )
    yield Finding(
        id="still_commands",
        severity="warning" if moving else "note",
        text=f"{', '.join(names)} never change{'' if len(names) > 1 else 's'}: {told}; is this the right "
        "column?",
        evidence={"commands": float(len(still))},
    )


def _still(data: Array) -> bool:
    there = data[np.isfinite(data)]
    return not len(there) or bool(np.max(there) == np.min(there))


def _moved(row: Excited) -> bool:
    return not any(text.startswith("anything") for text in row.cannot)


def _acting_on(vehicle: Vehicle, place: int) -> set[str]:
    """Commands of the thrusters that push along a degree of freedom, or its force itself."""
    pushing = {t.name for t in vehicle.thrusters if t.wrench[place]}
    return pushing | ({f"tau_{FORCE[place]}"} & {*vehicle.command_names})


def _headings(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    if not {"surge", "yaw"} <= set(vehicle.degrees_of_freedom) or not all(r.has("psi") for r in runs):
        return
    headings = np.concatenate([r.channels["psi"] for r in runs])
    span = float(np.nanmax(headings) - np.nanmin(headings))
    if span < _HEADINGS:
        yield Finding(
            id="headings",
            severity="note",
            text=f"headings span {np.degrees(span):.0f} degrees: a current cannot be told from a constant "
            "force, nor a flaw of the velocity sensor from one of the compass",
            evidence={"span": span},
        )
