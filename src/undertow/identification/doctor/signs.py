"""Signs: direction of the response to every command in every run, whatever else acts; unsigned squares.

The force that a motion requires is regressed on the force of every command according to the vehicle file,
each with its own gain, together with damping, lift and constant forces of any size. Gains are 1 if the file
is right, and may be far from it; none is negative. A reading of the logs is contradicted by how much worse
they are explained if gains may not be negative.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import sympy as sm
from scipy.optimize import nnls

from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import heterogeneity
from undertow.identification.findings import Finding
from undertow.identification.logs.run import Run
from undertow.model.effect import Effect, Wrench
from undertow.model.symbols import FORCE, VELOCITY, Signals
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags

from .dynamics import Dynamics, most_active_part, rederived
from .forces import FORCES, StatedForces, orthogonal_to
from .mistakes import Explanation, Mistake, Undo
from .sensors import SETTINGS as SENSORS
from .sensors import clustered_least_squares


@dataclass(frozen=True)
class SignSettings:
    """Thresholds beyond which gains show that commands are wired, named or signed wrongly."""

    samples: int = 2000  # samples of a run that are looked at, the most active
    # Share of what nothing else explains that commands must explain for a motion to be evidence.
    share: float = 0.1
    # Share of it that positive gains must leave beyond free ones to count: thrusters that are weaker astern
    # and the like do less.
    least_cost: float = 0.05
    # Gain beyond which, either way, it is no evidence of a command that is read wrongly: the stated force is
    # too small to distinguish from missing effects. Units are found by themselves (degrees make 57); good
    # models have shown 0.08 and 3.
    strongest: float = 10.0
    # Standard errors by which logs must contradict a reading: what a model lacks makes a few of them.
    certain: float = 10.0
    shows: float = 3.0  # the same from which a run takes part in the count
    agreeing: float = 0.8  # share of those runs that must be better without the mistake
    excluded: float = 3.0  # standard errors by which a mistake is excluded beside another one
    as_good: float = 0.8  # share of the best one's explained force that another must explain


SETTINGS = SignSettings()
Key = tuple[str, str]
"""Degree of freedom and command."""


@dataclass(frozen=True)
class SignEvidence:
    """How well logs agree with one reading of them."""

    # contradiction: (runs,) standard errors, squared, by which gains would have to be negative;
    # explained: share of the force that gains that are not negative explain, mean over motions and runs.
    contradiction: Array
    explained: float
    rows: int  # motions and runs that are evidence
    gains: list[dict[Key, tuple[float, float]]] = field(default_factory=list)  # and their errors, by run

    @property
    def total(self) -> float:
        """Contradiction of all runs."""
        return float(self.contradiction.sum())

    @property
    def spread(self) -> float:
        """Contradiction that errors of the model make where nothing is read wrongly, per row."""
        return max(1.0, self.total / max(self.rows, 1))


@dataclass(frozen=True)
class _MotionInRun:
    """One motion in one run: what nothing else explains of the force, and of that of its commands."""

    force: Array
    given: Array
    names: tuple[Key, ...]

    def fitted(self) -> _Fitted:
        size = np.linalg.norm(self.given, axis=0)
        columns, whole = self.given / size, float(self.force @ self.force)
        free, *_ = np.linalg.lstsq(columns, self.force, rcond=np.sqrt(FORCES.distinct))
        left = float(np.sum((self.force - columns @ free) ** 2))
        _, positive = nnls(np.hstack([columns, -columns[:, _implausible(free / size)]]), self.force)
        scale = max(np.sqrt(left / len(self.force)), 1e-6 * np.sqrt(whole / len(self.force)))
        gain, error = clustered_least_squares(
            columns / scale, self.force / scale, SENSORS.cluster, FORCES.distinct
        )
        inverse = np.linalg.pinv(columns.T @ columns, rcond=FORCES.distinct, hermitian=True)
        plain = scale * np.sqrt(np.maximum(np.diag(inverse), 1e-300))
        more = max(0.0, positive**2 - left)
        errors = more / scale**2 / float(np.max(error / plain)) ** 2
        gains = zip(self.names, (gain / size).tolist(), (error / size).tolist(), strict=True)
        return _Fitted(
            free=1.0 - left / whole,
            positive=1.0 - positive**2 / whole,
            contradiction=errors if more > SETTINGS.least_cost * whole else 0.0,
            gains={name: (g, e) for name, g, e in gains},
        )


@dataclass(frozen=True)
class _Fitted:
    """Shares explained by free gains and by those that are not negative, and what the latter cost."""

    free: float
    positive: float
    contradiction: float
    gains: dict[Key, tuple[float, float]]


class Signs:
    """Readings of logs, weighed against each other on every run."""

    def __init__(self, vehicle: Vehicle, runs: Sequence[Run]) -> None:
        self.vehicle, self._forces = vehicle, StatedForces(vehicle)
        self.runs = [most_active_part(run, vehicle, SETTINGS.samples) for run in runs]
        rows = [self._rows(run) for run in self.runs]
        known = [{dof: row.fitted() for dof, row in of.items()} for of in rows]
        self._evidence = [[dof for dof, f in of.items() if f.free > SETTINGS.share] for of in known]
        self.given = self._weight(known)

    def without(self, undo: Undo) -> SignEvidence:
        """The weight of the logs with a mistake undone."""
        runs = zip(self.runs, self._evidence, strict=True)
        undone = [self._rows(rederived(run, undo), only=of) for run, of in runs]
        return self._weight([{dof: row.fitted() for dof, row in of.items()} for of in undone])

    def _weight(self, fitted: list[dict[str, _Fitted]]) -> SignEvidence:
        seen = [
            [of[dof] for dof in evidence if dof in of]
            for of, evidence in zip(fitted, self._evidence, strict=True)
        ]
        rows = sum(map(len, self._evidence))
        return SignEvidence(
            np.array([sum(f.contradiction for f in of) for of in seen]),
            sum(f.positive for of in seen for f in of) / max(rows, 1),
            rows,
            [{key: g for f in of for key, g in f.gains.items()} for of in seen],
        )

    def _rows(self, run: Run, only: Iterable[str] | None = None) -> dict[str, _MotionInRun]:
        table = self._forces.table([run], SETTINGS.samples)
        names, found = self.vehicle.command_names, dict[str, _MotionInRun]()
        if table is None:
            return found
        own = len(names) - len(self.vehicle.inputs)
        for i, dof in enumerate(self.vehicle.degrees_of_freedom):
            given = table.commanded[:, i]
            acting = [k for k in range(own) if np.any(given[:, k])]
            beside = np.column_stack([table.others, given[:, own:]])
            enough = len(given) >= 2 * (beside.shape[1] + len(acting))
            if not acting or not enough or (only is not None and dof not in only):
                continue
            rest = orthogonal_to(beside, np.column_stack([table.force[:, i], given[:, acting]]))
            left = np.linalg.norm(rest, axis=0)
            seen = [k for k in range(len(acting)) if left[1 + k] > 0]
            if seen and left[0] > 0 and np.isfinite(rest).all():
                keys = tuple((dof, names[acting[k]]) for k in seen)
                found[dof] = _MotionInRun(rest[:, 0], rest[:, [1 + k for k in seen]], keys)
        return found

    def possible(self, known: Sequence[Mistake]) -> list[Mistake]:
        """The mistakes that logs contradict least, and all that do as well; none unless that is certain."""
        if self.given.total <= SETTINGS.certain**2:
            return []
        tested = [(m, self.without(m.undo)) for m in known]
        return _remaining(tested, [w for _, w in tested if self._agrees_better(w)])

    def not_excluded(self, known: Sequence[Mistake]) -> list[Mistake]:
        """The mistakes that logs contradict least; none if the reading as it is does as well."""
        tested = [(m, self.without(m.undo)) for m in known]
        return _remaining(tested, [w for _, w in tested], self.given)

    def suspected(self, known: Sequence[Mistake]) -> list[Mistake]:
        """The mistakes without which no run contradicts its reading, where the logs are short of certain."""
        tested = [(m, self.without(m.undo)) for m in known]
        whole = [
            w for _, w in tested if w.total <= SETTINGS.shows**2 and self._agrees_better(w, SETTINGS.shows)
        ]
        return _remaining(tested, whole)

    def _agrees_better(self, other: SignEvidence, certain: float | None = None) -> bool:
        """Whether logs contradict another reading less, certainly and in nearly all runs with evidence."""
        gained = self.given.contradiction - other.contradiction
        clear = np.abs(gained) > SETTINGS.shows**2
        agree = np.sum(gained[clear] > 0) >= SETTINGS.agreeing * np.sum(clear)
        more = other.explained > self.given.explained
        enough = gained.sum() > (certain or SETTINGS.certain) ** 2 * other.spread
        return bool(np.any(clear) and agree and more and enough)

    def text(self) -> tuple[str, dict[str, float]]:
        """The gains that are negative, in words and in numbers."""
        parts: list[str] = []
        evidence: dict[str, float] = {}
        for dof, command in dict.fromkeys(key for of in self.given.gains for key in of):
            values = np.array([of[dof, command] for of in self.given.gains if (dof, command) in of])
            gain, error = _mean(*values.T)
            certain = int(np.sum(values[:, 0] < -SETTINGS.shows * values[:, 1]))
            tells = gain < -SETTINGS.shows * error or certain >= SETTINGS.agreeing * len(values)
            if not _implausible(np.median(np.abs(values[:, 0]))) and tells:
                runs = f" ({certain} of {len(values)} runs show it)" if len(values) > 1 else ""
                parts.append(f"{dof} answers {command} by {gain:.2g} ± {error:.1g}{runs}")
                evidence |= {f"{dof}_{command}": gain, f"{dof}_{command}_error": error}
        return f"{', '.join(parts)} of what the vehicle file says", evidence


def _implausible(gain: Array | np.floating) -> Flags:
    """Which gains are beyond what commands that are read wrongly make of them."""
    return np.asarray(np.abs(gain) > SETTINGS.strongest)


def _remaining(
    tested: Sequence[tuple[Mistake, SignEvidence]],
    good: Sequence[SignEvidence],
    given: SignEvidence | None = None,
) -> list[Mistake]:
    """Mistakes that do as well as the best of the good ones: the simplest, then what explains most."""
    # None where the reading that is `given` does so, too.
    if not good:
        return []
    enough = SETTINGS.as_good * max(w.explained for w in good)
    best = min((w for w in good if w.explained >= enough), key=lambda w: w.total)
    near = best.total + SETTINGS.excluded**2 * best.spread
    if given is not None and given.total <= near and given.explained >= enough:
        return []
    left = [(m, w) for m, w in tested if w.total <= near and w.explained >= enough]
    return [m for m, _ in sorted(left, key=lambda pair: (pair[0].count, -pair[1].explained))]


def _mean(value: Array, error: Array) -> tuple[float, float]:
    """Mean over runs that differ by more than their errors, and its error."""
    variance = np.maximum(error, 1e-12) ** 2
    between = heterogeneity(value, variance)[1] if len(value) > 1 else 0.0
    weight = 1.0 / (variance + between**2)
    return float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)


WIRING = ("reversed_thruster", "swapped_thrusters", "frame", "flipped_axis")
"""Ids of mistakes that change the sign by which motions answer commands."""


def signs_of(vehicle: Vehicle, runs: Sequence[Run]) -> Signs | None:
    """The signs of all commands; None where actuation that depends on the motion hides them."""
    try:
        return Signs(vehicle, runs)
    except UndertowError:
        return None


def by_signs(
    signs: Signs,
    found: Explanation | None,
    known: Callable[[], list[Mistake]],
    fits: Callable[[Mistake], bool] = lambda _: True,
) -> Explanation | None:
    """What the signs of all commands in all runs say of the wiring that a fit found wrong, if any.

    `known` gives the mistakes that may be named. Those that do as well as the one found are named with it;
    what does worse gives way to them. None where the signs as they are do as well: then they are not wrong.
    Where no fit has found one, only those that `fits` allows are named.
    """
    if found is None:
        certain = signs.given.total > SETTINGS.certain**2
        possible = [*filter(fits, signs.possible(known()))] if certain else []
    else:
        others = known()
        own = [] if any(m.clause == found.mistake.clause for m in others) else [found.mistake]
        possible = signs.not_excluded([*own, *others])
        if not possible:
            return None
    why, evidence = signs.text()
    if not possible or (found is None and not evidence):
        return found
    clauses = ", or ".join(m.clause for m in possible)
    if found is not None and (not evidence or [m.clause for m in possible] == [found.mistake.clause]):
        text = clauses + found.text.removeprefix(found.mistake.clause)
        return replace(found, mistake=possible[0], rivals=possible[1:], text=text)
    return Explanation(possible[0], f"{clauses}: {why}", evidence, possible[1:])


def suspected(signs: Signs, known: Callable[[], list[Mistake]]) -> Explanation | None:
    """What the signs of all commands say of a wiring that is not certain enough to be undone."""
    possible = signs.suspected(known()) if signs.given.total > SETTINGS.shows**2 else []
    why, evidence = signs.text()
    if not possible or not evidence:
        return None
    return Explanation(possible[0], f"{possible[0].clause}: {why}", evidence, possible[1:])


# --- squares ----------------------------------------------------------------------------------
def lost_signs(at: Dynamics) -> Iterator[Finding]:
    """Effects with the square of a velocity in the force along it: drag that pushes when moving astern."""
    # They are reported where |u| u in its place explains the logs decisively.
    vehicle = at.vehicle
    for effect in vehicle.effects:
        if not isinstance(effect, Wrench) or not (squares := _unsigned_squares(effect, vehicle)):
            continue
        mended, terms = _with_signs(effect), ", ".join(squares)
        others = tuple(mended if e is effect else e for e in vehicle.effects)
        fit = at.refitted(vehicle=replace(vehicle, effects=others))
        if fit is not None and (gain := at.gain(fit)).decisive:
            yield Finding(
                id="lost_sign",
                severity="mistake",
                text=f"effect {effect.id} has a square without its sign ({terms}), which pushes when moving "
                f"astern; with |u| u for u^2, {gain.text}",
                evidence=gain.evidence,
                vehicle=f"effect {effect.id}: write sm.Abs(u) * u where it has u**2 ({terms})",
            )


def _unsigned_squares(effect: Wrench, vehicle: Vehicle) -> list[str]:
    signals = vehicle.composition.signals
    wrench = effect.wrench(signals)
    return [
        f"{FORCE[i]}: {VELOCITY[i]}^2"
        for i in vehicle.dof_indices
        if any(wrench[i].has(v**2) for v in (signals.nu[i], signals.nu_r[i]))
    ]


def _with_signs(effect: Wrench) -> Effect:
    """The same effect with |v| v for v^2 along each motion."""
    kind = type(effect)

    def wrench(self: Wrench, s: Signals) -> sm.Matrix:
        signed = [{v**2: sm.Abs(v) * v for v in (s.nu[i], s.nu_r[i])} for i in range(6)]
        rows = zip(kind.wrench(self, s), signed, strict=True)
        return sm.Matrix([sm.sympify(row, strict=True).xreplace(meanings) for row, meanings in rows])

    # The contract of an effect is kept: only its statement changes.
    return type(kind.__name__, (kind,), {"wrench": wrench, "__doc__": kind.__doc__})(effect.thrusters)
