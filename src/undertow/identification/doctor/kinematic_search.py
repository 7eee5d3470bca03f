"""Which mistakes in reading a log would make pose rates and velocities agree."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from .kinematics import Kinematics, Mismatch
from .mistake import SETTINGS, Mistake, both
from .units import UNITS_OF_MOTION

# A mismatch below this share of the motion is left to the effects that describe real sensors.
MATTERS = 0.02
# ... and noise must not make a quarter of it.
_OVER_NOISE = 4.0
# Undoing a mistake must take this factor off the mean square.
DECISIVE = 4.0
# No other pose rate may get worse by more than this factor (and this much).
_WORSE, _SLIGHTLY = 1.25, 0.01
# Explanations that leave no more than this many times the best one's excess are as good as it.
_AS_GOOD, _NOTHING = 2.0, 3e-3
# Pairs of mistakes are looked for only where pose rates and velocities hardly have anything in common.
_GROSS = 0.3
# Samples in which pairs are looked for.
_FEW = 800


@dataclass(frozen=True)
class Explained:
    """A mistake with what undoing it does.

    Attributes
    ----------
    mistake : Mistake
        The best explanation.
    rivals : list of Mistake
        Others that leave as little.
    before, after : Mismatch
        Of the log with the mistake, and without.
    """

    mistake: Mistake
    rivals: list[Mistake]
    before: Mismatch
    after: Mismatch


def inconsistent(mismatch: Mismatch) -> np.ndarray:
    """Blocks in which pose rates and velocities disagree by more than noise and small sensor errors."""
    return (mismatch.excess > MATTERS) & (mismatch.share > _OVER_NOISE * mismatch.floor)


def explains(before: Mismatch, after: Mismatch) -> bool:
    """Whether a mismatch goes away decisively, and none appears elsewhere."""
    wrong, gone = inconsistent(before), _gone(before, after)
    worse = after.excess > _WORSE * before.excess + _SLIGHTLY
    return bool(np.any(wrong & gone) and not np.any(worse))


def contradicts(found: Explained, chosen: Mistake) -> bool:
    """Whether pose rates and velocities are too far apart for any sensor where a mistake explains them."""
    return _explained(found.before, found.after) > possible_mismatch(chosen)


def possible_mismatch(chosen: Mistake) -> float:
    """Share of the motion by which sensors let pose rates and velocities disagree where this explains it."""
    return SETTINGS.other_unit if chosen.id in UNITS_OF_MOTION else SETTINGS.contradiction


def _explained(before: Mismatch, after: Mismatch) -> float:
    """Largest mismatch that has gone."""
    return float(np.max(before.excess[_gone(before, after)], initial=0.0))


def _gone(before: Mismatch, after: Mismatch) -> np.ndarray:
    """Blocks whose mismatch goes away, so that pose rates and velocities have more in common than apart.

    Else noise that is scaled away with its motion would count as explained.
    """
    return (after.excess <= before.excess / DECISIVE) & (after.share < SETTINGS.agreement)


def best_explanation(
    kinematics: Kinematics, runs: Sequence[Run], known: Iterable[Mistake], vehicle: Vehicle
) -> Explained | None:
    """The mistake that explains most of a mismatch; None where there is none, or nothing explains it.

    Single mistakes are tried first; pairs only where none helps and the mismatch is gross.
    """
    before = kinematics.mismatch(runs)
    if not np.any(inconsistent(before)):
        return None
    distinct = _distinct(kinematics, runs, known)
    found = _decisive(kinematics, runs, before, distinct)
    if not found and np.max(before.excess) > _GROSS:
        found = _pairs(kinematics, runs, before, distinct, vehicle)
    if not found:
        return None
    least = min(after.total for _, after in found)
    limit = _AS_GOOD * least + _NOTHING
    equals = sorted((m.count, i) for i, (m, after) in enumerate(found) if after.total <= limit)
    order = [found[i] for _, i in equals]
    return Explained(order[0][0], [m for m, _ in order[1:]], before, order[0][1])


def _pairs(
    kinematics: Kinematics, runs: Sequence[Run], before: Mismatch, distinct: list[Mistake], vehicle: Vehicle
) -> list[tuple[Mistake, Mismatch]]:
    """Pairs of mistakes that explain a mismatch, looked for in few samples and confirmed in all."""
    few = Kinematics(runs, vehicle, most=_FEW)
    if not few:
        return []
    likely = [m for m in distinct if m.id not in UNITS_OF_MOTION or _nearer(few, runs, m)]
    pairs = [both(a, b) for a, b in combinations(likely, 2) if a.id != b.id]
    found = _decisive(few, runs, few.mismatch(runs), pairs)
    return _decisive(kinematics, runs, before, [m for m, _ in found])


def _nearer(kinematics: Kinematics, runs: Sequence[Run], mistake: Mistake) -> bool:
    """Whether pose rates and velocities are nearer in size without a mistake, whatever their directions."""
    now, then = (_sizes(kinematics, of) for of in (runs, [mistake.undo(run) for run in runs]))
    return bool(np.any(then < now - np.log(1.0 + SETTINGS.ratio)))


def _sizes(kinematics: Kinematics, runs: Sequence[Run]) -> Array:
    """How far pose rates and velocities are apart in size, as a logarithm, for each block."""
    rates = kinematics.rates(runs)
    pose, velocity = (
        np.array([np.sum(np.mean(a[:, b] ** 2, axis=0)) for b in kinematics.blocks])
        for a in (rates.pose, rates.velocity)
    )
    return np.abs(np.log(np.maximum(pose, 1e-300) / np.maximum(velocity, 1e-300))) / 2


def _decisive(
    kinematics: Kinematics, runs: Sequence[Run], before: Mismatch, known: Iterable[Mistake]
) -> list[tuple[Mistake, Mismatch]]:
    tried = ((m, kinematics.mismatch([m.undo(run) for run in runs])) for m in known)
    found = [(m, after) for m, after in tried if explains(before, after)]
    # A little less mismatch is no other unit: that makes much of it.
    return [
        (m, after)
        for m, after in found
        if m.id not in UNITS_OF_MOTION or _explained(before, after) > SETTINGS.other_unit
    ]


def _distinct(kinematics: Kinematics, runs: Sequence[Run], known: Iterable[Mistake]) -> list[Mistake]:
    """Mistakes that change something that is looked at, each change once."""
    seen: list[Array] = [_looked_at(kinematics, runs[0])]
    result = []
    for mistake in known:
        now = _looked_at(kinematics, mistake.undo(runs[0]))
        if not any(np.allclose(now, other, rtol=1e-9, atol=1e-12, equal_nan=True) for other in seen):
            seen.append(now)
            result.append(mistake)
    return result


def _looked_at(kinematics: Kinematics, run: Run) -> Array:
    """A few samples of the channels that take part."""
    step = max(1, len(run.t) // 50)
    return np.array([run.channels[n][::step] for n in kinematics.channels])
