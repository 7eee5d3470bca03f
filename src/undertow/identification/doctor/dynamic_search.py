"""Which mistakes, in a log or in a vehicle file, would make the motion fit the commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow.model.vehicle import Vehicle

from ..logs import Mapping, Run
from ..weak.fit import WeakFit, settled
from .command_mistakes import other_units, reversed_commands, swapped_commands, together
from .dynamics import Dynamics, Gain
from .kinematic_search import inconsistent
from .kinematics import Kinematics
from .mistake import Mistake
from .reading_mistakes import reading_mistakes
from .units import SPEEDS, UNITS_OF_MOTION

# Candidates that are fitted to the end after a first look at all of them.
_FITTED, _UNITS_FITTED = 4, 2
_WORTH_A_FIT = 1.1
# Explanations within this factor of the best one's are as good as it.
_AS_GOOD = 1.5
_CHANGES = 1e-9
# Share of the motion by which pose rates and velocities may disagree in a log that is a witness at all.
_UNREADABLE = 0.5


@dataclass(frozen=True)
class Explanation:
    """A mistake with what undoing it does to the fit of the model.

    Attributes
    ----------
    mistake : Mistake
        The best explanation.
    gain : Gain
        What it does.
    rivals : list of Mistake
        Others that do as well.
    """

    mistake: Mistake
    gain: Gain
    rivals: list[Mistake]


def best_of(at: Dynamics, known: Sequence[Mistake]) -> Explanation | None:
    """The mistake whose undoing explains the motion decisively; None where none does."""
    promising = [m for _, m in _promising(at, known)]
    # Units are many, and neighbours promise alike: they must not crowd out the others.
    units, others = (
        [m for m in promising if (m.id in UNITS_OF_MOTION) is is_unit] for is_unit in (True, False)
    )
    leading = [*others[:_FITTED], *units[:_UNITS_FITTED]]
    return _chosen(at, [(m, fit) for m in leading if (fit := at.refitted(undo=m.undo)) is not None])


def _promising(at: Dynamics, known: Sequence[Mistake]) -> list[tuple[float, Mistake]]:
    """Mistakes that are worth a fit, with what one step of it promises; the best first."""
    looked = [(at.promised(m.undo) or 0.0, i) for i, m in enumerate(known)]
    return [(promise, known[i]) for promise, i in sorted(looked, reverse=True) if promise > _WORTH_A_FIT]


def _chosen(at: Dynamics, fitted: Sequence[tuple[Mistake, WeakFit]]) -> Explanation | None:
    # Under the noise model of the wrong reading a fit stops early: those that help get their own.
    helping = [(m, at.gain(settled(fit))) for m, fit in fitted if at.gain(fit).decisive]
    found = [(m, g) for m, g in helping if g.decisive]
    if not found:
        return None
    most = max(g.overall for _, g in found)
    equals = sorted((pair for pair in found if pair[1].overall > most / _AS_GOOD), key=lambda p: p[0].count)
    return Explanation(*equals[0], [m for m, _ in equals[1:]])


def dynamic_mistakes(
    vehicle: Vehicle, at: Dynamics, kinematics: Kinematics, runs: Sequence[Run], mapping: Mapping
) -> Explanation | None:
    """The mistake in frames that kinematics cannot see, or in commands, that explains the motion decisively.

    None where pose rates and velocities hardly have anything in common: whatever fits such a log better is
    no evidence of anything.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    at : Dynamics
        Its fit to (part of) the logs.
    kinematics : Kinematics
        What pose rates and velocities allow.
    runs : sequence of Run
        The logs.
    mapping : Mapping
        How they were read.
    """
    if kinematics and np.any(kinematics.mismatch(runs).excess > _UNREADABLE):
        return None
    commands = [*swapped_commands(vehicle), *other_units(vehicle, at.runs)]
    signs = reversed_commands(vehicle)
    # One velocity in another unit than the others, by less than no force could give, is a scale.
    speeds = sum(n in SPEEDS for n in vehicle.velocity_names)
    known = reading_mistakes(mapping, runs)
    known = [m for m in known if m.id != "speed_unit" or len(m.edits(mapping)) == speeds]
    unseen = allowed(kinematics, runs, at, known)
    found = best_of(at, [*unseen, *signs, *commands])
    return found or _two_reversed(at, signs)


def _two_reversed(at: Dynamics, signs: list[Mistake]) -> Explanation | None:
    """Two reversed thrusters: the one that helps most, with each of the others."""
    single = [m for m in signs if m.count == 1]
    looked = _promising(at, single)
    if len(single) < 3 or not looked:
        return None
    first = looked[0][1]
    return best_of(at, [together(first, other) for other in single if other is not first])


def allowed(
    kinematics: Kinematics, runs: Sequence[Run], at: Dynamics, known: Sequence[Mistake]
) -> list[Mistake]:
    """Mistakes that pose rates and velocities do not speak against and that matter to the model.

    None where pose rates and velocities disagree: a log that cannot be read is no witness for the model.
    """
    result: list[Mistake] = []
    given = kinematics.mismatch(runs) if kinematics else None
    if given is not None and np.any(inconsistent(given)):
        return result
    seen = [_felt(at, at.runs[0])]
    for mistake in known:
        now = _felt(at, mistake.undo(at.runs[0]))
        if any(np.allclose(now, other, rtol=_CHANGES, atol=_CHANGES, equal_nan=True) for other in seen):
            continue
        undone = [mistake.undo(run) for run in runs]
        if given is None or kinematics.mismatch(undone).total < 1.25 * given.total + 0.01:
            seen.append(now)
            result.append(mistake)
    return result


def _felt(at: Dynamics, run: Run) -> np.ndarray:
    """A few samples of what the model feels of a log."""
    names = [n for n in (*at.data.names, *at.data.commands) if run.has(n) and n not in ("x", "y")]
    names += [n for n in ("x", "y") if run.derived and run.has(n)]
    step = max(1, len(run.t) // 50)
    return np.array([run.channels[n][::step] for n in names])
