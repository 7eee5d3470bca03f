"""The whole examination of logs: sampling, the usual mistakes, consistency, excitation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.estimation.threads import one_thread
from undertow.identification.findings import SEVERITIES, Examination, Finding, percent
from undertow.identification.logs.mapping import Edit, Edits, LogMapping, as_toml, edited
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.effect import Effect
from undertow.model.effects.ocean_current import OceanCurrent
from undertow.model.effects.velocity_lever_arm import VelocityLeverArm
from undertow.model.vehicle import Vehicle
from undertow.typing import Progress
from undertow.version import __version__

from . import mistakes, sensors
from .clocks import causal, clock_findings, command_clock, delay_edits, latencies, without_latencies
from .compass import deviation
from .dynamics import (
    Dynamics,
    dynamic_mistakes,
    dynamics_of,
    not_fitted,
    other_mass,
    rederived,
    wiring_mistakes,
)
from .forces import doubtful_unit, exceeded_limits, impossible
from .headings import heading_findings, heading_off
from .jumps import coarse_positions, pose_steps, position_jumps
from .kinematics import Kinematics, rms
from .mistakes import (
    POSITIONS,
    UNITS_OF_MOTION,
    Explanation,
    Mistake,
    Undo,
    other_time_unit,
    reading_mistakes,
)
from .quotients import finding_on_quotients
from .sampling import DROP, excitation, excitation_findings, held_channels, read_when_new, sampling
from .sensors import Explained, best_explanation, contradicts, inconsistent, possible_mismatch
from .signs import WIRING, by_signs, lost_signs, signs_of, suspected


def _explanation(
    kinematics: Kinematics, found: Explained, chosen: Mistake, rivals: list[Mistake], runs: Sequence[Run]
) -> Explanation:
    """A mistake that shows in the kinematics of runs."""
    names = [", ".join(kinematics.rows[i] for i in block) for block in kinematics.blocks]
    before, after = found.before, found.after
    rows = np.flatnonzero(inconsistent(before) | (after.excess < before.excess / 2))
    parts = [f"{names[i]} {percent(before.share[i])} → {percent(after.share[i])}" for i in rows]
    sizes = _rms_in_words(kinematics, found, runs) if chosen.id in UNITS_OF_MOTION else ""
    mismatch = f"the mismatch between pose rate and velocity changes: {', '.join(parts)} of the motion"
    text = f"{chosen.clause}: {sizes}when corrected, {mismatch}"
    evidence = {f"mismatch_{names[i].replace(', ', '')}": float(before.share[i]) for i in rows}
    evidence |= {f"{k}_undone": float(after.share[i]) for k, i in zip(list(evidence), rows, strict=True)}
    text += f" (mean square; noise {percent(float(np.max(before.floor[rows])))})"
    return Explanation(chosen, text, evidence, rivals)


def _rms_in_words(kinematics: Kinematics, found: Explained, runs: Sequence[Run]) -> str:
    """How fast the position changes where that contradicts the velocities most, by both."""
    linear = [i for i, block in enumerate(kinematics.blocks) if kinematics.rows[block[0]] in POSITIONS]
    block = kinematics.blocks[max(linear, key=lambda i: found.before.excess[i])]
    rates = kinematics.rates(runs)
    pose, velocity = (rms(a[:, block]) for a in (rates.pose, rates.velocity))
    names = ", ".join(kinematics.rows[i] for i in block)
    verb = "change" if len(block) > 1 else "changes"
    return f"{names} {verb} by {pose:.3g} m/s rms, and the velocities say {velocity:.3g} m/s; "


@dataclass(frozen=True)
class ExaminationSettings:
    """How many mistakes are looked for, and which of several that explain the same is supported."""

    most_mistakes: int = 3  # of one kind, found and undone one after another
    most_equals: int = 4  # mistakes that explain as much, compared by refitting the model without each
    # Factor by which what the model leaves beyond the noise has to differ between two of them.
    decisive: float = 2.0


SETTINGS = ExaminationSettings()
# In one motion alone, or for all of them alike, this does the same as a unit.
_WEAK_THRUSTERS = "thrusters that are weaker or stronger than in the vehicle file (thruster_gain)"
_MODEL = "a term that the model lacks, or a controller that responds to the motion"
# What may make a motion look as if it were read in another unit or with another sign.
_OTHER_EXPLANATIONS: dict[type[Effect], str] = {
    OceanCurrent: "a current that the vehicle file lacks (ocean_current), which explains as much",
    VelocityLeverArm: "a velocity sensor away from the origin (velocity_lever_arm), which explains as much",
}


@dataclass(frozen=True)
class Examined:
    """An examination with its subject."""

    result: Examination  # what is written to JSON
    # given, mended: the logs, less those that are wrong alone, and what they are once the mistakes found are
    # undone.
    given: list[Run]
    mended: list[Run]
    edits: Edits  # what to change in the mapping file


@one_thread()
def examine(
    vehicle: Vehicle,
    runs: Sequence[Run],
    *,
    mapping: LogMapping | None = None,
    report: Progress = lambda done, words: None,
) -> Examined:
    """Look for what is wrong with logs, which must have the velocities and commands of the vehicle.

    Without a `mapping`, the one with which the runs were read is used.
    """
    began = time.perf_counter()
    for run in runs:
        run.matrix([*vehicle.velocity_names, *vehicle.command_names])
    read_by = mapping or next((r.mapping for r in runs if r.mapping is not None), LogMapping())
    excluded = _only_wrong(vehicle, runs)
    examiner = _Examiner(vehicle, [run for run in runs if run.name not in excluded], read_by)
    examiner.findings += excluded.values()
    report(0.0, "checking clock and samples")
    examiner.check_samples()
    examiner.undo_held_values()
    report(0.1, "comparing pose rates with velocities")
    if examiner.is_timed:
        examiner.undo_reading_mistakes()
        examiner.undo_impossible()
    report(0.4, "comparing motion with commands")
    if examiner.is_timed:
        examiner.undo_model_mistakes()
    report(0.7, "checking sensors and excitation")
    rows = excitation(vehicle, examiner.runs)
    examiner.check_sensors()
    report(0.8, "checking the clock of the commands and the vehicle file")
    if examiner.is_timed:
        examiner.check_vehicle_file()
    examiner.findings += excitation_findings(rows, vehicle, examiner.runs)
    result = Examination(
        undertow=__version__,
        vehicle=vehicle.name,
        runs=[r.name for r in runs],
        findings=sorted(examiner.findings, key=lambda f: SEVERITIES.index(f.severity)),
        excitation=rows,
        seconds=time.perf_counter() - began,
    )
    return Examined(result, examiner.given, examiner.runs, tuple(examiner.edits))


def refuse_impossible(vehicle: Vehicle, runs: Sequence[Run], *, trust_log: bool = False) -> None:
    """Refuse impossible logs, by the quick checks of `examine`; each log by itself, unless `trust_log`.

    Refused are logs whose pose rates and velocities contradict each other, or whose motion no vehicle of this
    mass, size and thrust can have, where a usual mistake explains it. A log that lacks a velocity or a
    command is not examined.
    """
    needed = [*vehicle.velocity_names, *vehicle.command_names]
    for run in runs:
        if trust_log or not all(run.has(n) for n in needed):
            continue
        where = f"log '{run.source or run.name}'"
        override = "override with --trust-log (trust_log=True)"
        examiner = _of_one(vehicle, run)
        silent = sensors.without_measurement(examiner.kinematics, [run]) if examiner.kinematics else None
        refused = _refused(examiner)
        if not examiner.is_timed:
            bursts = next(f.text for f in examiner.findings if f.id == "bursts")
            raise UndertowError(f"log {bursts}, or {override}")
        if refused:
            raise UndertowError(
                f"{where} is impossible: {refused.text}; write {_on_one_line(examiner.edits)} into the "
                f"mapping file (undertow doctor --mend does so), or {override}"
            )
        if unmeasured := examiner.unmeasured or silent:
            raise UndertowError(f"{where}: {unmeasured.text}, or {override}")


def _of_one(vehicle: Vehicle, run: Run) -> _Examiner:
    return _Examiner(vehicle, [run], run.mapping or LogMapping())


def _refused(examiner: _Examiner) -> Finding | None:
    """Impossible contents of a log."""
    examiner.check_samples()
    if examiner.is_timed:
        examiner.undo_reading_mistakes()
        examiner.undo_impossible()
    return examiner.refused


def _only_wrong(vehicle: Vehicle, runs: Sequence[Run]) -> dict[str, Finding]:
    """Impossible contents of some of the logs, by name, if the others do not show them."""
    # Taken together, logs with a mistake and logs without it would show nothing, or what is true of neither.
    found = {r.name: _refused(_of_one(vehicle, r)) for r in runs} if len(runs) > 1 else {}
    wrong = {name: finding for name, finding in found.items() if finding is not None}
    if len(wrong) == len(runs):
        return {}
    return {
        name: finding.model_copy(update={"text": f"{name}, but not all of the logs: {finding.text}"})
        for name, finding in wrong.items()
    }


class _Examiner:
    """Logs under examination: every mistake found is corrected before the next is sought."""

    def __init__(self, vehicle: Vehicle, runs: list[Run], mapping: LogMapping) -> None:
        self.vehicle, self.given, self.runs, self.mapping = vehicle, list(runs), runs, mapping
        self.kinematics = Kinematics(runs, vehicle)
        self.findings: list[Finding] = []
        self.edits: list[Edit] = []
        self.refused: Finding | None = None
        self.unmeasured: Finding | None = None
        self._fitted: tuple[Sequence[Run], Dynamics | None] = ((), None)

    @property
    def is_timed(self) -> bool:
        """Whether rates of change mean something: units and signs are judged by them."""
        return not any(f.id == "bursts" for f in self.findings)

    @property
    def _names(self) -> tuple[str, ...]:
        """Channels of pose and velocity of the vehicle, and those with which they are compared."""
        vehicle = self.vehicle
        return (*dict.fromkeys((*vehicle.pose_names, *self.kinematics.rows, *vehicle.velocity_names)),)

    def _use(self, runs: list[Run]) -> None:
        """Go on with the logs without a mistake."""
        self.runs, self.kinematics = runs, Kinematics(runs, self.vehicle)

    def check_samples(self) -> None:
        if stamps := mistakes.times_of_day(self.runs, self.mapping):
            self._undo(stamps, apply=self._rederived, impossible=True)
        self.findings += sampling(self.runs, self._names, self.mapping)
        if any(f.id == "disorder" and f.severity == "mistake" for f in self.findings):
            self._add_edits(DROP)
        self._drop_quotients()
        if unit := other_time_unit(self.kinematics, self.runs, self.mapping):
            text = f"{unit.clause}: only then are pose rates and velocities of the same size"
            self._undo(Explanation(unit, text, {}), impossible=True)
        self._mend_angles([n for n in self.vehicle.pose_names if n not in self.kinematics.rows])

    def _drop_quotients(self) -> None:
        """Derive anew what was divided by steps that jitter: everything else would be judged by its noise."""
        if not (self.kinematics and self.is_timed):
            return
        found, names = finding_on_quotients(self.runs, self.kinematics)
        if found is not None:
            self.findings.append(found)
            self.unmeasured = found if found.severity == "mistake" else None
            dofs = self.vehicle.degrees_of_freedom
            self._use([velocities_from_pose(run.without(names), dofs) for run in self.runs])

    def undo_held_values(self) -> None:
        """Read sensors that are slower than the log where they are new: held values look like a delay."""
        held = held_channels(self.runs, self._names, self.mapping)
        if held:
            self._use([self._rederived(run, lambda r: read_when_new(r, held)) for run in self.runs])
            self._add_edits([edit for edits in held.values() for edit in edits])

    def _mend_angles(self, names: Sequence[str]) -> None:
        """Undo what angles show by themselves: degrees, of those named, and jumps."""
        if degrees := mistakes.in_degrees(self.runs, self.mapping, names):
            self._undo(degrees, apply=self._rederived, impossible=True)
        for wrapped in mistakes.wrapped_angles(self.runs):
            self._undo(wrapped)

    def undo_reading_mistakes(self) -> None:
        for _ in range(SETTINGS.most_mistakes):
            if not self.kinematics or not self._undo_next(self.kinematics):
                break
        # Degrees that also jump have no rate that any single mistake would mend.
        if self.kinematics and sensors.contradicted(self.kinematics, self.runs):
            self._mend_angles([n for n in self.vehicle.pose_names if n == "theta"])
        self.findings += mistakes.angles_across_jumps(self.runs)

    def _undo_next(self, kinematics: Kinematics) -> bool:
        """Undo the mistake that explains most; False where there is none that is certain."""
        fits = sensors.sensor_fits(kinematics, self.runs)
        offset = sensors.heading_offset(kinematics, self.runs, self.mapping)
        known = [*reading_mistakes(self.mapping, self.runs), *offset]
        found = best_explanation(kinematics, self.runs, known, self.vehicle)
        water = sensors.through_water(kinematics, kinematics.mismatch(self.runs), fits)
        # Against the water that moves with it, a vehicle that hardly moves seems to go the other way.
        if water is not None and (found is None or water.after.total < found.after.total):
            found = sensors.with_rivals(water, found)
        if found is None:
            return False
        others = [f.description() for f in sensors.as_good_as(found, fits)]
        chosen, rivals = supported_by_model(self.vehicle, self.runs, found)
        if chosen is not found.mistake:
            found = replace(found, after=kinematics.mismatch([chosen.undo(run) for run in self.runs]))
        explanation = _explanation(kinematics, found, chosen, rivals, self.runs)
        if others:
            self._doubt(explanation, [*(r.clause for r in rivals), *others])
            return False
        # Water may well move as fast as a vehicle does.
        gross = chosen.id != "velocity_through_water" and contradicts(found, chosen)
        beyond = f"; sensor errors explain at most {percent(possible_mismatch(chosen))}" if gross else ""
        self._undo(replace(explanation, text=explanation.text + beyond), impossible=gross)
        return True

    def undo_impossible(self) -> None:
        """Undo what pose rates and velocities leave open, but no vehicle of this mass and thrust can do."""
        for _ in range(SETTINGS.most_mistakes):
            found = impossible(self.vehicle, self.runs, self.mapping, self.kinematics)
            if found is None:
                return
            self._undo(found, impossible=True)

    def undo_model_mistakes(self) -> None:
        for _ in range(SETTINGS.most_mistakes):
            at = self._dynamics()
            if at is None or not at.unexplained:
                break
            found = self._model_mistake(at)
            if found is None:
                break
            if others := self._other_explanations(at, found.mistake):
                self._doubt(found, others)
                break
            self._undo(found)
        if not any(f.severity == "mistake" for f in self.findings):
            doubtful = doubtful_unit(self.vehicle, self.runs, self.mapping, self.kinematics)
            if doubtful is not None:
                self._doubt(doubtful, [*(r.clause for r in doubtful.rivals), _WEAK_THRUSTERS])

    def _dynamics(self) -> Dynamics | None:
        """The vehicle fitted to the logs as they are now; None where that cannot be done."""
        if self._fitted[0] is not self.runs:
            self._fitted = (self.runs, dynamics_of(self.vehicle, self.runs))
        return self._fitted[1]

    def _other_explanations(self, at: Dynamics, mistake: Mistake) -> list[str]:
        """What else than another unit or sign explains how the model does."""
        if mistake.id in ("reversed_thruster", "swapped_thrusters"):
            # With its heading off, a vehicle seems to go elsewhere than its commands push it.
            offset = heading_off(self.vehicle, self.mapping, self.runs)
            return [] if offset is None else [offset.clause]
        if mistake.id not in (*UNITS_OF_MOTION, "flipped_axis"):
            return []
        if len(self.vehicle.dof_indices) == 1 and mistake.id in UNITS_OF_MOTION:
            return [_WEAK_THRUSTERS]
        return [_OTHER_EXPLANATIONS[e] for e in at.explained_as_well(mistake, _OTHER_EXPLANATIONS)]

    def _model_mistake(self, at: Dynamics) -> Explanation | None:
        """What the fit of the model shows, and, where that leaves much, what the signs of commands do."""
        known = (self.vehicle, at, self.kinematics, self.runs, self.mapping)
        found = dynamic_mistakes(*known)
        if found is not None and (found.mistake.id not in WIRING or at.explained_by(found.mistake)):
            return found
        signs = signs_of(self.vehicle, self.runs)
        if signs is None:
            return found
        possible = cache(lambda: wiring_mistakes(*known))
        wrong = by_signs(signs, found, possible, at.no_worse)
        if wrong is not None:
            return wrong
        doubt = found or suspected(signs, possible)
        if doubt is not None and at.predicted_better(doubt.mistake):
            self._doubt(doubt, [*(m.clause for m in doubt.rivals), _MODEL])
        return None

    def check_sensors(self) -> None:
        self.findings += sensors.not_compared(self.kinematics, self.vehicle)
        self.findings += heading_findings(self.vehicle, self.mapping, self.runs)
        self.findings += exceeded_limits(self.vehicle, self.runs)
        self.findings += position_jumps(self.vehicle, self.runs)
        self.findings += pose_steps(self.vehicle, self.runs)
        self.findings += coarse_positions(self.runs)
        self._undo_deviation()
        kinematics = self.kinematics
        if kinematics:
            found = causal(self.vehicle, self.runs, latencies(kinematics, self.runs))
            prompt = without_latencies(self.runs, found)
            self.findings += sensors.sensor_findings(kinematics, prompt)
            self.findings += clock_findings(kinematics, self.runs, found, self.mapping)
            self.findings += sensors.agreement(kinematics, prompt)
            clear = [one for one in found if one.clear(self.runs[0].step)]
            for one in clear:
                self._add_edits(delay_edits(one, self.mapping))
            if clear:
                self.runs = prompt

    def check_vehicle_file(self) -> None:
        """The clock of the commands, and mistakes in the vehicle file, judged by sensors that are in time."""
        at = self._dynamics()
        if at is None:
            self.findings += not_fitted(self.vehicle, self.runs)
            return
        if at.unexplained or any(run.reported for run in self.runs):
            clock = command_clock(at, self.mapping)
            self.findings += [] if clock is None else [clock]
        if at.unexplained:
            self.findings += lost_signs(at)
        if (mass := other_mass(at)) is not None:
            self.findings.append(mass)

    def _undo_deviation(self) -> None:
        """Turn headings, and what was turned by them, by the deviation of the compass, if that is sure."""
        found = deviation(self.vehicle, self.runs)
        if found is None:
            return
        self.findings.append(found.finding(self.mapping))
        self._use([self._rederived(run, found.undo) for run in self.runs])
        self._add_edits(found.edits(self.mapping))

    def _rederived(self, run: Run, undo: Undo) -> Run:
        """A run without a mistake, its velocities derived anew where they were derived from its pose."""
        if not run.derived:
            return undo(run)
        own = replace(run.without(run.derived), derived=frozenset())
        return velocities_from_pose(undo(own), self.vehicle.degrees_of_freedom)

    def _undo(
        self, found: Explanation, apply: Callable[[Run, Undo], Run] = rederived, impossible: bool = False
    ) -> None:
        mistake, edits = found.mistake, found.mistake.edits(self.mapping)
        finding = Finding(
            id=mistake.id,
            severity="mistake",
            text=found.text,
            evidence=found.evidence,
            mapping=as_toml(edits),
            vehicle=mistake.vehicle,
            alternatives=[f"{r.clause}: {_on_one_line(r.edits(self.mapping))}" for r in found.rivals],
        )
        self.findings.append(finding)
        self.refused = self.refused or (finding if impossible else None)
        self._use([apply(run, mistake.undo) for run in self.runs])
        self._add_edits(edits)

    def _add_edits(self, edits: Iterable[Edit]) -> None:
        self.mapping = edited(self.mapping, edits)
        self.edits += edits

    def _doubt(self, found: Explanation, others: list[str]) -> None:
        """Report a possible mistake or sensor error without correcting it."""
        self.findings.append(
            Finding(
                id=found.mistake.id,
                severity="warning",
                text=f"perhaps {found.text}",
                evidence=found.evidence,
                mapping=as_toml(found.mistake.edits(self.mapping)),
                alternatives=others,
            )
        )


def _on_one_line(edits: Iterable[Edit]) -> str:
    """Changes of a mapping file as `[table] key = value; key = value; [table] ...`."""
    tables: dict[str, list[str]] = {}
    for e in edits:
        tables.setdefault(e.table, []).append(as_toml([Edit("", e.key, e.value)]))
    return "; ".join(f"[{table}] {'; '.join(lines)}" for table, lines in tables.items())


# --- mistakes that explain as much --------------------------------------------------------------------
def supported_by_model(
    vehicle: Vehicle, runs: Sequence[Run], found: Explained
) -> tuple[Mistake, list[Mistake]]:
    """The mistake that the model supports, and those that it does not contradict."""
    equals = [found.mistake, *found.rivals][: SETTINGS.most_equals]
    if len(equals) == 1:
        return found.mistake, []
    left = []  # by the refitted model beyond the noise, geometric mean over its equations of motion
    for mistake in equals:
        at = dynamics_of(vehicle, [mistake.undo(run) for run in runs])
        left.append(np.inf if at is None else np.exp(np.mean(np.log(np.maximum(at.residual, 1.0)))))
    best = min(left)
    good = [m for m, value in zip(equals, left, strict=True) if not value > SETTINGS.decisive * best]
    return good[0], good[1:]
