"""How well a model explains logs, and how much better with mistakes in commands or vehicle file corrected."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.identification.estimation.data import WeakData, inverse_of, prepare
from undertow.identification.estimation.fitted import MORE_THAN_CHANCE
from undertow.identification.estimation.prediction_error import refit_by_prediction_error, vuong_p_value
from undertow.identification.estimation.residual import whitened
from undertow.identification.estimation.step import Constraints, normal_equations, prior_of
from undertow.identification.estimation.weak_form import (
    WeakFit,
    fit_under_noise,
    fit_weak,
    free_parameters,
    mean_square,
    with_reestimated_noise,
)
from undertow.identification.findings import Examination, Finding
from undertow.identification.logs.mapping import Edit, LogMapping, column_edit, column_of
from undertow.identification.logs.run import Run
from undertow.model.effect import Effect
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.units import PULSES
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .kinematics import Kinematics, jacobian, most_active
from .mistakes import (
    PLAUSIBLE,
    SPEEDS,
    UNITS_OF_MOTION,
    Explanation,
    Mistake,
    Undo,
    exchanged,
    reading_mistakes,
    rescaled,
    with_channels,
)
from .sensors import SETTINGS as SENSORS
from .sensors import inconsistent, still_good


@dataclass(frozen=True)
class DynamicsSettings:
    """Thresholds beyond which the fit of a model shows that a log is misread."""

    samples: int = 1600  # samples that are fitted, all runs together, in three degrees of freedom
    samples_of_many: int = 600  # the same with more than `many` degrees of freedom
    many: int = 4
    # Mean square, in units of the noise, beyond which a model that was refitted does not explain its log.
    unexplained: float = 2.0
    # Factor that undoing a mistake must take off what an equation leaves beyond the noise.
    decisive: float = 10.0
    # Less is enough where noise is all that remains, since a feedback loop, too, makes a model with a wrong
    # sign look better.
    decisive_to_noise: float = 4.0
    excited: float = 5.0  # spread of a velocity over its noise from which its equation of motion is evidence
    worse: float = 1.25  # no other equation may get worse by more than this factor
    # Unless that costs less than this share of what is gained: what the model lacks makes some difference.
    # Of 62 mirrored logs of five simulated vehicles, whose models mostly lacked effects, 0 misses three and
    # 0.001 to 0.03 miss one, which from 0.1 on is taken for reversed commands (in eleven others exchanged or
    # reversed commands do the same). Of 63 logs as they should be none is called mistaken at any value.
    cost: float = 0.01
    unit: float = 5.0  # change of a channel's spread that only another unit explains
    negligible: float = 0.5  # excess over the noise that counts as none
    # Share by which two thrusters must differ to be exchanged, and so must their commands: thrusters of one
    # make differ by more than that.
    alike: float = 0.02
    fitted: int = 4  # mistakes that are fitted until convergence after a screening of all
    units_fitted: int = 2  # units among them: neighbours predict alike, and must not crowd out the others
    least_predicted_fall: float = 1.1  # predicted reduction from which a mistake is fitted
    as_good: float = 1.5  # explanations within this factor of the best one's are as good as it
    false_alarm_rate: float = 0.01  # of predictions that say that commands are wired in another way
    changes: float = 1e-9  # change of a sample that is none
    # Largest command over full power, and longest pulse in microseconds, in a log that has no other unit.
    full: float = 1.05
    longest_pulse: float = 2310.0
    # Share of the motion by which pose rates and velocities may disagree in a log that is evidence at all.
    unreadable: float = 0.5
    lightest: float = 0.6  # another mass is accepted from this factor of the one in the file
    heaviest: float = 2.5  # and up to this one
    least: float = 0.1  # and only where it differs by this share
    certain: float = 3.0  # standard errors by which another mass must differ
    # The same where added masses that were far off come back to their stated values with it.
    certain_beside: float = 1.0
    near_prior: float = 2.0  # standard deviations within which an added mass is at its prior
    far_from_prior: float = 4.0  # standard deviations that one of them must be off


SETTINGS = DynamicsSettings()
_UNDONE = "_undone"  # ends names of evidence: what is left once a mistake is undone


@dataclass(frozen=True)
class Dynamics:
    """A vehicle's model on logs, refitted."""

    vehicle: Vehicle
    runs: list[Run]  # the part of the logs that is looked at
    data: WeakData
    fit: WeakFit  # the fit, under a noise model that takes what the model does not explain for a disturbance
    # (n,) mean square of what it leaves of each equation of motion, in units of the sensors' noise.
    residual: Array
    # Fits with a mistake undone, which several questions ask for.
    _fits: dict[Mistake, WeakFit | None] = field(init=False, default_factory=dict, repr=False)

    @property
    def unexplained(self) -> bool:
        """Whether the logs say that something is wrong with the model, or with how they are read."""
        return bool(np.any(self.residual > SETTINGS.unexplained))

    def predicted_reduction(self, undo: Undo) -> float | None:
        """Factor by which one Gauss-Newton step from the file's values would explain the motion better once a
        mistake is undone; geometric mean over the equations of motion. None where it cannot be tried.
        """
        data = self.undone(undo)
        if data is None:
            return None
        model, size = self.fit.model, len(self.residual)
        p = np.array([self.vehicle.value_of(n).value for n in self.vehicle.parameter_names], dtype=float)
        at = whitened(model.linearise(data, p), self.fit.whitening)
        # Without bounds, which would cost more than all the rest of a first look.
        gram, slope = normal_equations(at, p[list(model.places)], prior_of(model))
        step = -inverse_of(gram) @ slope
        after = mean_square(at.r + at.J @ step, data)[:size]
        return float(np.exp(np.mean(np.log(self.fit.mean_square()[:size] / np.maximum(after, 1e-12)))))

    def refitted(
        self, vehicle: Vehicle | None = None, undo: Undo | None = None, free: Sequence[str] = ()
    ) -> WeakFit | None:
        """The fit with something changed, under the same noise model; None where it cannot be made."""
        data = self.data if undo is None else self.undone(undo)
        if data is None:
            return None
        model = vehicle or self.vehicle
        names = (*free_parameters(model), *free)
        noise = self.fit.whitening, self.fit.disturbance
        try:
            return fit_under_noise(Constraints().model(model, names), data, {}, *noise)
        except (UndertowError, np.linalg.LinAlgError):
            return None

    def without(self, mistake: Mistake) -> WeakFit | None:
        """The fit with a mistake undone; None where it cannot be made."""
        if mistake not in self._fits:
            self._fits[mistake] = self.refitted(undo=mistake.undo)
        return self._fits[mistake]

    def undone(self, undo: Undo) -> WeakData | None:
        """The data with a mistake undone in every run; None where samples or a motion would go missing.

        Turned by a right angle, a vehicle without sway would not move, and any model explains that.
        """
        runs = tuple(rederived(run, undo) for run in self.runs)
        measured = [run.known(self.data.names) for run in runs]
        commands = [run.matrix(self.data.commands) for run in runs]
        segments = tuple(
            replace(s, measured=measured[s.run][s.samples], u=commands[s.run][s.samples])
            for s in self.data.segments
        )
        if not all(np.isfinite(s.measured).all() and np.isfinite(s.u).all() for s in segments):
            return None
        both = (np.concatenate([s.measured for s in of]) for of in (self.data.segments, segments))
        before, after = (np.std(of, axis=0) for of in both)
        if np.any(after < SETTINGS.changes * before):
            return None
        sigma = self.data.sigma * _other_unit(before, after)
        return replace(self.data, runs=runs, segments=segments, sigma=sigma)

    def explained_by(self, mistake: Mistake) -> bool:
        """Whether the residual of some equation of motion is close to noise once a mistake is corrected."""
        fit = self.without(mistake)
        return fit is not None and self.gain(with_reestimated_noise(fit)).explained

    def no_worse(self, mistake: Mistake) -> bool:
        """Whether the refitted model explains the motion as well or better once a mistake is undone."""
        # By what both fits minimise. In units of the noise of the sensors a fit that makes the vehicle heavy
        # leaves less, since its inertia multiplies that noise.
        fit = self.without(mistake)
        return fit is None or fit.cost <= self.fit.cost

    def predicted_better(self, mistake: Mistake) -> bool:
        """Whether predictions one step ahead, with process noise in the model, say that there is a mistake.

        Thrust that opposes a disturbance looks reversed, but not in these. True where they cannot be made.
        """
        undone = self.without(mistake)
        if undone is None:
            return True
        try:
            given = refit_by_prediction_error(self.fit, self.runs)
            corrected = refit_by_prediction_error(undone, [rederived(r, mistake.undo) for r in self.runs])
            return vuong_p_value(given, corrected) < SETTINGS.false_alarm_rate
        except UndertowError:
            return True

    def explained_as_well(self, mistake: Mistake, effects: Iterable[type[Effect]]) -> list[type[Effect]]:
        """Those effects that the vehicle lacks which explain the motion as well as undoing a mistake does."""
        undone = self.without(mistake)
        if undone is None:
            return []
        gain = self.gain(with_reestimated_noise(undone)).overall
        return [e for e in effects if self._gain_with(e) * SETTINGS.as_good > gain]

    def _gain_with(self, effect: type[Effect]) -> float:
        """What the model is better by with an effect; 0 where it has that or none of its parameters shows."""
        if any(e.id == effect.id for e in self.vehicle.effects):
            return 0.0
        vehicle = self.vehicle.with_effect(effect, {})
        names = [n for n in vehicle.parameter_names if n not in self.vehicle.parameter_names]
        fit = self.refitted(vehicle=vehicle, free=names)
        return 0.0 if fit is None else self.gain(with_reestimated_noise(fit)).overall

    def gain(self, fit: WeakFit) -> Gain:
        """What a changed fit is better by."""
        size = len(self.residual)
        spread = np.std(np.concatenate([s.measured[:, size:] for s in self.data.segments]), axis=0)
        excited = np.asarray(spread > SETTINGS.excited * self.data.sigma[size:])
        left = normalised_mean_square(fit)[:size]
        return Gain(self.vehicle.degrees_of_freedom, self.residual, left, excited)


@dataclass(frozen=True)
class Gain:
    """Residual of a refitted model in each equation of motion, before and after a change."""

    names: tuple[str, ...]  # degrees of freedom
    # before, after: (n,) mean squares in units of the sensors' noise.
    before: Array
    after: Array
    excited: NDArray[np.bool_]  # (n,) whether the velocity stands out of its noise

    @property
    def factors(self) -> Array:
        """How many times what exceeds the noise is smaller after the change, (n,)."""
        excess = [np.maximum(a - 1.0, SETTINGS.negligible) for a in (self.before, self.after)]
        return np.asarray(excess[0] / excess[1])

    @property
    def overall(self) -> float:
        """Geometric mean of the factors."""
        return float(np.exp(np.mean(np.log(self.factors))))

    @property
    def explained(self) -> bool:
        """Whether the residual is close to noise after the change."""
        return bool(np.all(self.after < SETTINGS.unexplained))

    @property
    def decisive(self) -> bool:
        """Whether the change explains at least one equation of motion and spoils none."""
        needed = SETTINGS.decisive_to_noise if self.explained else SETTINGS.decisive
        wrong = (self.before > SETTINGS.unexplained) & self.excited
        return bool(np.any(self.factors[wrong] >= needed) and not np.any(self._worsened))

    @property
    def _worsened(self) -> NDArray[np.bool_]:
        """Equations that get worse by more than goes along with what the others gain, (n,)."""
        gained = np.sum(np.maximum(self.before - self.after, 0.0))
        costly = self.after - self.before > SETTINGS.cost * gained
        return np.asarray((self.factors <= 1.0 / SETTINGS.worse) & costly)

    @property
    def text(self) -> str:
        """The equations that a change explains much better, in words."""
        rows = zip(self.names, self.before, self.after, self.factors, strict=True)
        parts = [f"{dof} {b:.3g} → {a:.3g}" for dof, b, a, factor in rows if factor > 2]
        return f"the refitted model leaves {', '.join(parts)} times the noise (mean square)"

    @property
    def evidence(self) -> dict[str, float]:
        """The same in numbers, for all of them."""
        rows = zip(self.names, self.before.tolist(), self.after.tolist(), strict=True)
        return {f"{dof}{when}": v for dof, b, a in rows for when, v in (("", b), (_UNDONE, a))}


def normalised_mean_square(fit: WeakFit) -> Array:
    """Mean square residual of a fit in every equation, in units of sensor noise, (2n,)."""
    whitening = fit.model.whitening(fit.data, fit.p)
    return mean_square(whitened(fit.model.linearise(fit.data, fit.p), whitening).r, fit.data)


def _other_unit(before: Array, after: Array) -> Array:
    """Factors of the noise if a channel is in another unit now: smaller is not better for that reason."""
    ratio = after / np.where(before > 0, before, np.inf)
    return np.where((ratio > 0) & ((ratio < 1 / SETTINGS.unit) | (ratio > SETTINGS.unit)), ratio, 1.0)


def dynamics_of(vehicle: Vehicle, runs: Sequence[Run]) -> Dynamics | None:
    """Fit a vehicle to the most_active part of logs; None where they are too short or hold no motion."""
    most = SETTINGS.samples if len(vehicle.dof_indices) <= SETTINGS.many else SETTINGS.samples_of_many
    try:
        parts = [most_active_part(run, vehicle, most // len(runs)) for run in runs]
        data = prepare(parts, vehicle)
        fit = fit_weak(vehicle, data)
    except (UndertowError, np.linalg.LinAlgError):
        return None
    return Dynamics(vehicle, parts, data, fit, normalised_mean_square(fit)[: len(vehicle.dof_indices)])


def not_fitted(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Why a model cannot be fitted to logs, if it cannot."""
    try:
        prepare(runs, vehicle)
    except UndertowError as error:
        text = f"no model can be fitted to these logs, and commands were not checked: {error}"
        yield Finding(id="not_fitted", severity="warning", text=text)


def most_active_part(run: Run, vehicle: Vehicle, most: int) -> Run:
    """The `most` samples in a row of a run in which the vehicle moves most."""
    piece = most_active(run, vehicle.velocity_names, most)
    return run.slice(float(run.t[piece.start]), float(run.t[piece.stop - 1]))


def rederived(run: Run, undo: Undo) -> Run:
    """Undo a mistake in a run; velocities that were derived from its pose follow the pose that is undone."""
    after = undo(run)
    if not run.derived:
        return after
    places = [VELOCITY.index(n) for n in run.derived]
    pose = run.known(POSE)
    rate = np.einsum("nij,nj->ni", jacobian(pose), run.known(VELOCITY))
    # Mistakes are affine in the pose, so that this difference is exact.
    plain = replace(run, wrapped={})
    displaced = with_channels(
        plain, {n: run.channels[n] + rate[:, POSE.index(n)] for n in POSE if run.has(n)}
    )
    before, later = (undo(r).known(POSE) for r in (plain, displaced))
    # The clock may be another one, too.
    slower = (after.t[-1] - after.t[0]) / (run.t[-1] - run.t[0])
    velocity = np.linalg.solve(jacobian(before), (later - before)[..., None]) / slower
    new = {VELOCITY[i]: np.asarray(velocity[:, i, 0]) for i in places}
    spread = [np.array([np.nanstd(of[n]) for n in new]) for of in (run.channels, new)]
    noise = zip(new, _other_unit(*spread), strict=True)
    sigma = {n: factor * run.sigma[n] for n, factor in noise if n in run.sigma}
    return replace(with_channels(after, new), sigma={**run.sigma, **sigma})


def reversed_commands(vehicle: Vehicle) -> list[Mistake]:
    """One command with the opposite sign, all of them, or all that do not push ahead."""
    names = tuple(n for n in vehicle.command_names if n not in vehicle.inputs)
    across = tuple(t.name for t in vehicle.thrusters if not t.wrench[0])
    several = {group for group in (names, across) if len(group) > 1}
    return [_reversed(vehicle, group) for group in (*((n,) for n in names), *sorted(several))]


def _reversed(vehicle: Vehicle, names: tuple[str, ...]) -> Mistake:
    clause = f"command {names[0]} is" if len(names) == 1 else f"commands {', '.join(names)} are"
    surfaces, thrusters = ({a.name for a in of} for of in (vehicle.surfaces, vehicle.thrusters))
    where = {n: f"[[surfaces]] {n}: axis" for n in surfaces}
    where |= {n: f"[[thrusters]] {n}: direction (or wrench)" for n in thrusters}
    # A known force is a column of the log alone.
    remedy = "; ".join(f"{where[n]} with the opposite sign" for n in names if n in where)
    factors = dict.fromkeys(names, -1.0)
    return rescaled("reversed_thruster", f"{clause} reversed", factors, len(names), remedy)


def swapped_commands(vehicle: Vehicle, runs: Sequence[Run] = ()) -> Iterator[Mistake]:
    """Two thrusters in each other's place, unless they do the same or have the same commands in all runs."""
    rows = list(vehicle.dof_indices)
    for one, other in combinations(vehicle.thrusters, 2):
        a, b = (np.array(t.wrench)[rows] * t.thrust_per_command.value for t in (one, other))
        given = [np.nan_to_num(run.matrix((one.name, other.name))).T for run in runs]
        distinct = not given or any(map(_differ, *zip(*given, strict=True)))
        if distinct and _differ(a, b):
            yield exchanged(
                "swapped_thrusters",
                f"commands {one.name} and {other.name} are swapped",
                {one.name: (other.name, 1.0), other.name: (one.name, 1.0)},
                f"[[thrusters]]: swap the names {one.name} and {other.name}",
            )


def _differ(a: Array, b: Array) -> bool:
    return bool(np.linalg.norm(a - b) > SETTINGS.alike * (np.linalg.norm(a) + np.linalg.norm(b)))


def other_units(vehicle: Vehicle, runs: list[Run]) -> Iterator[Mistake]:
    """Commands as percent, as a share of the largest, or as pulse widths, where the file has limits."""
    known, surfaces = vehicle.largest_commands, {s.name for s in vehicle.surfaces}
    limits = {name: most for name, most in known.items() if name not in surfaces}
    if not limits:
        return
    largest = max(float(np.nanmax(np.abs(r.channels[n]))) for r in runs for n in limits)
    travel, middle, longest = PULSES.span, PULSES.neutral, SETTINGS.longest_pulse
    units = {  # scale, offset, and what the largest in a log is at least and at most
        "in percent of the limit": (0.01, 0.0, SETTINGS.full, 100.0 * SETTINGS.full),
        "a share of the limit (-1 to 1)": (1.0, 0.0, 0.0, SETTINGS.full),
        "pulse widths in microseconds": (1.0 / travel, -middle / travel, middle - travel, longest),
    }
    for clause, (scale, offset, least, most) in units.items():
        nothing = offset == 0.0 and all(top * scale == 1.0 for top in limits.values())
        if least <= largest <= most and not nothing:
            scales = {n: (top * scale, top * offset) for n, top in limits.items()}
            yield in_other_unit(f"commands {', '.join(limits)} are {clause}", scales)


def in_other_unit(clause: str, scales: Mapping[str, tuple[float, float]]) -> Mistake:
    """Commands that have to be multiplied by a scale, to which an offset is added."""

    def undo(run: Run) -> Run:
        return with_channels(run, {n: scale * run.channels[n] + add for n, (scale, add) in scales.items()})

    def edit(mapping: LogMapping, name: str) -> Edit:
        (scale, add), (_, read) = scales[name], column_of(mapping, name)
        return column_edit(mapping, name, scale=scale * read.scale, offset=scale * read.offset + add)

    return Mistake("command_unit", clause, undo, lambda mapping: tuple(edit(mapping, n) for n in scales))


def decisive_mistake(at: Dynamics, known: Sequence[Mistake]) -> Explanation | None:
    """The mistake whose correction explains the motion decisively; None if none does."""
    promising = [m for _, m in _promising(at, known)]
    # Units are many, and neighbours predict alike: they must not crowd out the others.
    units = [m for m in promising if m.id in UNITS_OF_MOTION]
    others = [m for m in promising if m.id not in UNITS_OF_MOTION]
    leading = [*others[: SETTINGS.fitted], *units[: SETTINGS.units_fitted]]
    fitted = [(m, fit) for m in leading if (fit := at.without(m)) is not None]
    return _best_explanation(at, [(m, f) for m, f in fitted if m.id not in UNITS_OF_MOTION or _is_driven(f)])


def _is_driven(fit: WeakFit) -> bool:
    """Whether thrusters push in a fit: any unit that makes it smaller explains a motion without a force."""
    vehicle = fit.model.functions.vehicle
    linear = [i for i in vehicle.dof_indices if i < len(SPEEDS)]
    if not vehicle.thrusters or vehicle.surfaces or vehicle.force_channels:
        return True
    along = np.abs([t.wrench for t in vehicle.thrusters])[:, linear]
    stated = [t.thrust_per_command.value for t in vehicle.thrusters]
    found = [fit.values.get(f"thrust_{t.name}", k) for t, k in zip(vehicle.thrusters, stated, strict=True)]
    given, kept = (np.abs(gains) @ along for gains in (stated, found))
    return not np.any(given) or bool(np.any(kept > PLAUSIBLE.weakest * given))


def _promising(at: Dynamics, known: Sequence[Mistake]) -> list[tuple[float, Mistake]]:
    """Mistakes that are worth a fit, with what one step of it predicts; the best first."""
    promising = [(at.predicted_reduction(m.undo) or 0.0, i) for i, m in enumerate(known)]
    return [
        (predicted, known[i])
        for predicted, i in sorted(promising, reverse=True)
        if predicted > SETTINGS.least_predicted_fall
    ]


def _best_explanation(at: Dynamics, fitted: Sequence[tuple[Mistake, WeakFit]]) -> Explanation | None:
    # Under the noise model of the wrong reading a fit stops early: those that help get their own.
    helping = [(m, at.gain(with_reestimated_noise(fit))) for m, fit in fitted if at.gain(fit).decisive]
    found = [(m, g) for m, g in helping if g.decisive]
    if not found:
        return None
    most = max(g.overall for _, g in found)
    equals = sorted(
        (pair for pair in found if pair[1].overall > most / SETTINGS.as_good), key=lambda p: p[0].count
    )
    mistake, gain = equals[0]
    text = f"{mistake.clause}: when corrected, {gain.text}"
    return Explanation(mistake, text, gain.evidence, [m for m, _ in equals[1:]])


def dynamic_mistakes(
    vehicle: Vehicle, at: Dynamics, kinematics: Kinematics, runs: Sequence[Run], mapping: LogMapping
) -> Explanation | None:
    """The mistake in frames that kinematics cannot see, or in commands, that explains the motion decisively.

    None if pose rates and velocities are hardly related: a better fit to such a log is no evidence. Nor is it
    if no command ever changes: a motion without a force is explained by any unit that makes it smaller.
    """
    commands = [run.known(vehicle.command_names) for run in runs]
    if vehicle.command_names and not any(np.any(np.nanstd(c, axis=0) > 0.0) for c in commands):
        return None
    given = kinematics.mismatch(runs) if kinematics else None
    if given is not None and np.any((given.excess > SETTINGS.unreadable) & given.moves.astype(bool)):
        return None
    wiring = [*swapped_commands(vehicle, at.runs), *other_units(vehicle, at.runs)]
    signs = _distinguishable(at, reversed_commands(vehicle))
    # One velocity in another unit than the others, by less than no force could give, is a scale.
    speeds = sum(n in SPEEDS for n in vehicle.velocity_names)
    known = reading_mistakes(mapping, runs)
    known = [m for m in known if m.id != "speed_unit" or len(m.edits(mapping)) == speeds]
    invisible = consistent_with_kinematics(kinematics, runs, at, known)
    found = decisive_mistake(at, [*invisible, *signs, *wiring])
    return found or _two_reversed(vehicle, at, signs)


def _two_reversed(vehicle: Vehicle, at: Dynamics, signs: list[Mistake]) -> Explanation | None:
    """Two reversed thrusters: the one that helps most, with each of the others."""
    single = [m for m in signs if m.count == 1]
    promising = _promising(at, single)
    if len(single) < 3 or not promising:
        return None
    first = promising[0][1]
    names = [{e.key for m in (first, other) for e in m.edits(LogMapping())} for other in single]
    return decisive_mistake(at, [_reversed(vehicle, tuple(sorted(n))) for n in names if len(n) > 1])


def wiring_mistakes(
    vehicle: Vehicle, at: Dynamics, kinematics: Kinematics, runs: Sequence[Run], mapping: LogMapping
) -> list[Mistake]:
    """Mistakes that change the sign of the response to commands, as far as kinematics allow them."""
    axes = [m for m in reading_mistakes(mapping, runs) if m.id in ("frame", "flipped_axis")]
    turned = consistent_with_kinematics(kinematics, runs, at, axes)
    return [
        *_distinguishable(at, [*swapped_commands(vehicle, at.runs), *reversed_commands(vehicle)]),
        *turned,
    ]


def consistent_with_kinematics(
    kinematics: Kinematics, runs: Sequence[Run], at: Dynamics, known: Sequence[Mistake]
) -> list[Mistake]:
    """Mistakes that pose rates and velocities do not contradict and that matter to the model."""
    # None where pose rates and velocities disagree in what moves: such a log is no evidence about the model.
    result: list[Mistake] = []
    given = kinematics.mismatch(runs) if kinematics else None
    if given is not None and np.any(inconsistent(given) & given.moves):
        return result
    seen = [_signature(at, at.runs[0])]
    for mistake in known:
        now = _signature(at, mistake.undo(at.runs[0]))
        if _is_one_of(now, seen):
            continue
        undone = [mistake.undo(run) for run in runs]
        if given is None or np.all(kinematics.mismatch(undone).excess < still_good(given.excess)):
            seen.append(now)
            result.append(mistake)
    return result


def _distinguishable(at: Dynamics, known: Sequence[Mistake]) -> list[Mistake]:
    """Mistakes in commands, without those that logs cannot distinguish from others, or from none."""
    runs = at.runs
    seen, result = [np.hstack([_signature(at, run) for run in runs])], list[Mistake]()
    for mistake in known:
        now = np.hstack([_signature(at, mistake.undo(run)) for run in runs])
        if not _is_one_of(now, seen):
            seen.append(now)
            result.append(mistake)
    return result


def _is_one_of(signature: Array, seen: Sequence[Array]) -> bool:
    near = {"rtol": SETTINGS.changes, "atol": SETTINGS.changes}
    return any(np.allclose(signature, other, equal_nan=True, **near) for other in seen)


def _signature(at: Dynamics, run: Run) -> np.ndarray:
    """A few samples of the channels of a log that the model uses."""
    names = [n for n in (*at.data.names, *at.data.commands) if run.has(n) and n not in ("x", "y")]
    names += [n for n in ("x", "y") if run.derived and run.has(n)]
    step = max(1, len(run.t) // SENSORS.signature)
    return np.array([run.channels[n][::step] for n in names])


_TRANSLATION = ("X_udot", "Y_vdot", "Z_wdot")


def other_mass(at: Dynamics) -> Finding | None:
    """A stated mass that contradicts the logs; None if it does not, or they are not decisive."""
    # With free added masses without stated spread nothing can be concluded: they compensate for any mass. Nor
    # if another value of a fixed added mass explains as much.
    known = at.vehicle.values.get("m")
    if known is None or known.estimate or "m" not in at.vehicle.parameter_names:
        return None
    fit = at.refitted(free=("m",))
    if fit is None:
        return None
    found, error = fit.values["m"], fit.standard_errors["m"]
    ratio = found / known.value
    if not (SETTINGS.lightest < ratio < SETTINGS.heaviest and abs(ratio - 1) > SETTINGS.least):
        return None
    gain = at.gain(fit)
    shifted = _back_within_priors(at.fit, fit) if gain.explained else {}
    # What added masses and mass share is poorly known; that added masses are where they should be is not.
    limit = SETTINGS.certain_beside if shifted else SETTINGS.certain
    certain = abs(found - known.value) > limit * error
    if not certain or not (shifted or gain.decisive) or _added_mass_instead(at, fit):
        return None
    return _mass_finding({"stated": known.value, "found": found, "error": error}, gain, shifted)


def _mass_finding(mass: dict[str, float], gain: Gain, shifted: dict[str, float]) -> Finding:
    """`shifted` are added masses that leave their stated values, in standard deviations."""
    which = "dry" if mass["found"] > mass["stated"] else "wrong"
    sizes = ", ".join(f"{n} {z:+.1f}" for n, z in shifted.items())
    away = "with m as stated the added masses move away from their stated values"
    reason = f"{away} ({sizes} standard deviations)" if shifted else f"with it, {gain.text}"
    return Finding(
        id="dry_mass",
        severity="warning" if shifted else "mistake",
        text=f"m = {mass['stated']:.4g} kg looks like the {which} mass: the logs indicate "
        f"{mass['found']:.4g} ± {mass['error']:.2g} kg; {reason}",
        evidence=mass,
        vehicle=f'[effects.rigid_body] m = "{mass["found"]:.4g} kg" (the mass with the water inside)',
        alternatives=["for water that moves along but weighs nothing: undertow add entrained_water"],
    )


def _added_mass_instead(at: Dynamics, with_mass: WeakFit) -> bool:
    """Whether another value of one fixed added mass explains as much as another mass."""
    values = {n: at.vehicle.values[n] for n in _TRANSLATION if n in at.vehicle.values}
    tried = (at.refitted(free=(n,)) for n, v in values.items() if not v.estimate)
    return any(fit is not None and fit.cost < with_mass.cost + MORE_THAN_CHANCE for fit in tried)


def _back_within_priors(before: WeakFit, after: WeakFit) -> dict[str, float]:
    """Added masses that were several standard deviations off in the same direction, and no longer are."""
    before_z, after_z = (_standardised(f) for f in (before, after))
    shifted = {n: z for n, z in before_z.items() if abs(z) > SETTINGS.near_prior}
    same_sense = len(shifted) >= 2 and len({np.sign(z) for z in shifted.values()}) == 1
    far = max(map(abs, shifted.values()), default=0.0) > SETTINGS.far_from_prior
    near = all(abs(z) < SETTINGS.near_prior for z in after_z.values())
    return shifted if same_sense and far and near else {}


def _standardised(fit: WeakFit) -> dict[str, float]:
    vehicle = fit.model.functions.vehicle
    priors = {n: vehicle.value_of(n) for n in _TRANSLATION if n in fit.values}
    return {n: (fit.values[n] - v.value) / v.sigma for n, v in priors.items() if v.sigma}


def without_refuted(examined: Examination) -> Examination:
    """The findings without mistakes that explain less than the unchanged model, if that leaves only noise."""
    # Mistakes found through the fit of a model are believed only for want of a better explanation.
    kept = []
    for finding in examined.findings:
        left = [number for name, number in finding.evidence.items() if name.endswith(_UNDONE)]
        if finding.severity != "mistake" or max(left, default=0.0) <= SETTINGS.unexplained:
            kept.append(finding)
    return examined.model_copy(update={"findings": kept})
