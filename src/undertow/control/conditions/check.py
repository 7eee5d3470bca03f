"""The checker: every condition of a law, on every set of parameters, with certificates."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undertow.control.gains import GainSet, allocation_of
from undertow.errors import UndertowError, nearest, refuse_unknown
from undertow.typing import Array, Flags, Progress

from .attitude import Certificate
from .by_law import Condition, equilibria_without_thrust, lyapunov
from .channels import coupled, linear_channels, reaching, zero_dynamics
from .problem import (
    ALL,
    EXACT_PARAMETERS,
    NO_IOTA_THERE,
    NOMINAL,
    OPEN,
    SAMPLED,
    SEARCH,
    ParameterBox,
    Problem,
    RobustVerdict,
    SignSet,
    Span,
    Uncertainty,
    best_iota,
    distinct_for,
    interior_point,
)
from .region import region
from .result import FAILS, HOLDS, NO_IOTA, UNPROVED, Agreement, Region, Report, Row

_DERIVED = "derived"
Uncertain = float | Mapping[str, float] | Literal["stated"] | None


def check(
    gains: GainSet,
    uncertainty: Uncertainty | None = None,
    *,
    forms: Sequence[str] = (),
    iota: float | None = None,
    tilt: float = math.radians(SEARCH.tilt),
    start: Mapping[str, float] | None = None,
    uncertain: Uncertain = None,
    progress: Progress = lambda done, words: None,
) -> Report:
    """Check the gains of a law against every condition, without effects that no condition knows.

    As `control.api.check_gains`, with `tilt` in rad; `uncertainty` is that of the vehicle file unless given.
    """
    if iota is not None and not 0 < iota < np.inf:
        raise UndertowError(
            f"--iota {iota:g} is not positive and finite: leave it out to have it searched for"
        )
    _require_start(gains, start)
    _require_motion(gains)
    allocation_of(gains)  # refuses thrusters that cannot give the forces of the law
    uncertainty = uncertainty or Uncertainty(gains.plant.vehicle)
    full_problem = Problem(gains, tilt, _parameter_box(gains, uncertainty, uncertain))
    problem = full_problem.with_forms(forms)
    _require_damping(problem)
    progress(0.1, "conditions")
    agreements = _agreements(problem, iota)
    rows = _rows(problem, uncertainty, iota, agreements, progress)
    progress(0.8, "Lyapunov function")
    equilibria = equilibria_without_thrust(gains.plant, gains.law)
    return Report(
        vehicle=gains.plant.vehicle.name,
        gains=gains.name,
        law=gains.law.id,
        rows=(*rows, *(reaching(problem, uncertainty) if not forms or _DERIVED in forms else ())),
        agreements=tuple(agreements),
        channels=tuple(linear_channels(problem)),
        coupled=coupled(problem),
        lyapunov=lyapunov(gains.plant, gains.law, equilibria),
        region=_region(full_problem.with_forms([_DERIVED]), start, rows, agreements),
        zero_dynamics=zero_dynamics(gains),
        not_covered=dict(gains.plant.left_out),
        uncertainty=f"{uncertainty.confidence:.0%}, from the {uncertainty.source}",
    )


def _require_start(gains: GainSet, start: Mapping[str, float] | None) -> None:
    wrong = f" is not a coordinate of the pose of '{gains.plant.vehicle.name}'"
    refuse_unknown(start or {}, gains.signals.coordinates, "start: ", wrong, "give errors of")
    for name, size in (start or {}).items():
        if not 0 <= size < np.inf:
            raise UndertowError(f"start: {name} = {size:g} is not the size of an error: give zero or more")
    if start is not None and not any(start.values()):
        raise UndertowError("start: every error is zero: state the largest ones, as x=0.5")


def _parameter_box(gains: GainSet, uncertainty: Uncertainty, uncertain: Uncertain) -> ParameterBox:
    """The intervals of the parameters that a region has to hold for."""
    if uncertain is None:
        return EXACT_PARAMETERS
    if gains.law.id not in ("pd", "pid") or gains.unactuated:
        which = f"law '{gains.law.id}'" if gains.law.id not in ("pd", "pid") else "unactuated axes"
        raise UndertowError(f"--uncertain: with {which} no region is proved over parameters: leave it out")
    plant = gains.plant
    free = (plant.M.free_symbols | plant.C.free_symbols | plant.D.free_symbols) & set(plant.numbers)
    symbols = sorted(free - plant.g.free_symbols - plant.B.free_symbols, key=str)
    names = [str(s) for s in symbols]
    if uncertain == "stated":
        spans = uncertainty.intervals(names)
    else:
        shares = _shares(names, uncertain)
        values = [float(plant.numbers[s]) for s in symbols]
        spans = [(v - s * abs(v), v + s * abs(v)) for v, s in zip(values, shares, strict=True)]
    found = {s: (low, high) for s, (low, high) in zip(symbols, spans, strict=True) if high > low}
    if not found:
        raise UndertowError(
            "--uncertain: no parameter of inertia or damping has a standard deviation, or all are zero: "
            "state a share such as 10%"
        )
    return found


def _shares(names: Sequence[str], uncertain: float | Mapping[str, float]) -> list[float]:
    """The share by which each parameter may be off."""
    if not isinstance(uncertain, Mapping):
        uncertain = dict.fromkeys(names, uncertain)
    found = dict.fromkeys(names, 0.0)
    for name, share in uncertain.items():
        matching = [n for n in names if n in (name, f"{name}_forward", f"{name}_backward")]
        if not matching:
            raise UndertowError(
                f"--uncertain {name}: no such parameter of inertia or damping{nearest(name, names)}; there "
                f"are {', '.join(names)}"
            )
        if not 0 < share < 1:
            raise UndertowError(
                f"--uncertain {name} = {share:.4g} is not a fraction of a value: give one between 0 and 1, "
                "such as 10%"
            )
        found |= dict.fromkeys(matching, share)
    return [found[n] for n in names]


def _require_motion(gains: GainSet) -> None:
    """Refuse a J that is singular: with x_dot = cos(psi) u nothing moves x at a quarter turn."""
    across = {"x": ("surge", "sway"), "y": ("sway", "surge")}
    alone = {"x", "y"} & set(gains.signals.coordinates)
    if "psi" not in gains.signals.coordinates or len(alone) != 1:
        return
    present, missing = across[alone.pop()]
    raise UndertowError(
        f"'{gains.plant.vehicle.name}' yaws and has {present} without {missing}: at a heading of 90 deg from "
        f"its axis it cannot move along it, so that no condition holds at every heading; add {missing} to "
        "degrees_of_freedom, and to `unactuated` of the gains if nothing pushes it"
    )


def derived_conditions_hold(gains: GainSet) -> bool:
    """Whether every condition that is derived from the model holds, with one iota for all."""
    return check(gains, forms=[_DERIVED]).satisfied


def _region(
    problem: Problem, start: Mapping[str, float] | None, rows: list[Row], agreements: list[Agreement]
) -> Region:
    """The region of a law, by its derived conditions as matrices, over all attitudes and sign sets.

    `rows` and `agreements` are what was worked out; the derived ones are where other forms were asked for.
    """
    if problem.gains.unactuated:
        names = ", ".join(problem.gains.unactuated)
        are = "is" if len(problem.gains.unactuated) == 1 else "are"
        text = f"none is certified: {names} {are} unactuated, so V may rise"
        return Region("none", text, start=dict(start or {}), contains_start=False if start else None)
    derived_agreements = [a for a in agreements if a.form == _DERIVED]
    derived = [r for r in rows if r.form == _DERIVED]
    if not derived:
        derived_agreements = _agreements(problem, None)
        derived = _rows(problem, Uncertainty(problem.plant.vehicle), None, derived_agreements)
    verdicts = [r.verdict for r in derived] + [a.verdict for a in derived_agreements]
    return region(problem, all(v == HOLDS for v in verdicts), start)


def _require_damping(problem: Problem) -> None:
    needed = [c.statement for c in problem.conditions if "D" in c.uses]
    if needed and problem.plant.D.is_zero_matrix:
        raise UndertowError(
            f"'{problem.plant.vehicle.name}' has no damping, which the condition {needed[0]} is about: add "
            "[effects.linear_damping] or another effect of that family"
        )


def _agreements(problem: Problem, iota: float | None) -> list[Agreement]:
    found = []
    for form in dict.fromkeys(c.form for c in problem.conditions):
        conditions = [c for c in problem.conditions if c.form == form and not c.per_channel_only]
        if not any(c.uses_iota for c in conditions):
            continue
        interval = problem.iota_interval(conditions, problem.relevant_sets)
        holds = interval is not None and (iota is None or interval[0] < iota < interval[1])
        found.append(Agreement(form, interval, HOLDS if holds else NO_IOTA if interval is None else FAILS))
    return found


# --- rows -------------------------------------------------------------------------------------
def _rows(
    problem: Problem,
    uncertainty: Uncertainty,
    iota: float | None,
    agreements: list[Agreement],
    progress: Progress = lambda done, words: None,
) -> list[Row]:
    spans = {a.form: a.iota for a in agreements}
    rows: list[Row] = []
    for k, condition in enumerate(problem.conditions):
        progress(0.1 + 0.7 * k / len(problem.conditions), condition.statement)
        for channel in [*([] if condition.per_channel_only else [None]), *problem.driven]:
            evaluation = _Evaluation(problem, condition, channel, spans.get(condition.form), iota)
            rows += _rows_over_sets(evaluation, uncertainty)
    return rows


def _rows_over_sets(evaluation: _Evaluation, uncertainty: Uncertainty) -> list[Row]:
    """One row for all sets of parameters where they agree; of the mixed sets the worst, where it is worse."""
    sets = evaluation.problem.relevant_sets
    rows = [evaluation.row(signs, uncertainty) for signs in sets[:2]]
    if len(rows) == 2 and _same_verdicts(*rows):
        rows = [replace(rows[0], signs="both")]
    first = {signs.name for signs in sets[:2]}
    others = [signs for signs in distinct_for(evaluation.condition, sets) if signs.name not in first]
    if evaluation.channel is not None or not others:
        return rows
    if any(r.verdict != HOLDS for r in rows):
        others = [min(others, key=lambda signs: evaluation.rank(signs, rows[0].at_iota))]
    elif evaluation.proved(others):
        return rows
    least = min(r.margin for r in rows)
    mixed = [evaluation.row(signs, uncertainty) for signs in others]
    return rows + [r for r in mixed if r.margin < least - SEARCH.rounding * abs(least) and r.verdict != HOLDS]


def _same_verdicts(one: Row, other: Row) -> bool:
    keys = ("left", "right", "margin", "iota", "verdict")
    same = all(getattr(one, k) == getattr(other, k) for k in keys)
    return same and (one.box and one.box.verdict) == (other.box and other.box.verdict)


@dataclass(frozen=True)
class _Evaluation:
    """One condition on the matrices (channel None), or on a channel by its number."""

    problem: Problem
    condition: Condition
    channel: int | None
    common_iota: Span | None  # the values of iota that serve all conditions of the form
    requested_iota: float | None  # the iota that the caller states

    def row(self, signs: SignSet, uncertainty: Uncertainty) -> Row:
        condition, matrices, interval = self.condition, self.channel is None, self._iota_interval(signs)
        iota = self._iota(signs, interval)
        left, right, certificate = self._sides(signs, iota)
        verdict = self._verdict(certificate, interval)
        box, ellipsoid = self._robust_verdicts(signs, iota, verdict, uncertainty)
        return Row(
            form=condition.form,
            condition=condition.id,
            statement=condition.matrices if matrices else condition.statement,
            about=condition.about,
            source=condition.source,
            scope="matrices" if self.channel is None else self.problem.coordinates[self.channel],
            signs=signs.name,
            left=left,
            right=right,
            margin=certificate.least,
            verdict=verdict,
            iota=interval,
            uses_iota=condition.uses_iota,
            at_iota=iota,
            where=_worst_attitude(certificate),
            box=box,
            ellipsoid=ellipsoid,
        )

    def _verdict(self, certificate: Certificate, interval: Span | None) -> str:
        if certificate.least > 0:
            return HOLDS if certificate.bound > 0 else UNPROVED
        return NO_IOTA if self.condition.uses_iota and interval is None else FAILS

    def _iota(self, signs: SignSet, interval: Span | None) -> float | None:
        """The iota that serves all conditions if there is one, else one for this one, else the best."""
        if not self.condition.uses_iota:
            return None
        if self.requested_iota is not None:
            return self.requested_iota
        if self.common_iota is not None:
            return interior_point(self.common_iota)
        if interval:
            return interior_point(interval)
        return best_iota(
            lambda iotas: self.problem.margins(self.condition, signs, iotas, self.channel, few=True)
        )

    def _iota_interval(self, signs: SignSet) -> Span | None:
        condition = self.condition
        return self.problem.iota_interval([condition], [signs], self.channel) if condition.uses_iota else None

    def _margin(self, signs: SignSet, iota: float | None) -> float:
        return self.problem.margin(self.condition, signs, iota, self.channel)

    def rank(self, signs: SignSet, iota: float | None) -> float:
        """The margin at a few attitudes: which of many sets is worst, before anything is proved."""
        iotas = np.array([1.0 if iota is None else iota])
        return float(self.problem.margins(self.condition, signs, iotas, self.channel, few=True)[0])

    def proved(self, sets: Sequence[SignSet]) -> bool:
        """Whether it holds in all of these sets, at every attitude, with the iota that serves all."""
        served = not self.condition.uses_iota or self.common_iota is not None
        return served and self.problem.proved(self.condition, sets, self._iota(sets[0], None))

    def _sides(self, signs: SignSet, iota: float | None) -> tuple[float, float, Certificate]:
        if self.channel is not None:
            left, right = self.condition.sides(self.problem.channel_quantities(signs, self.channel, iota))
            margin = self._margin(signs, iota)
            return left, right, Certificate(margin, margin, {}, "")
        certificate = self.problem.certificate(self.condition, signs, iota)
        inverse = self.problem.attitudes.at(certificate.worst)
        left, right = self.condition.sides(self.problem.quantities(signs, inverse, iota))
        return left, right, certificate

    # --- uncertainty
    def _robust_verdicts(
        self, signs: SignSet, iota: float | None, verdict: str, uncertainty: Uncertainty
    ) -> tuple[RobustVerdict | None, RobustVerdict | None]:
        relevant, features = self._features(signs)
        known = np.diag(uncertainty.covariance(signs.names)) > 0
        if not (relevant & known).any():
            return None, None
        if verdict != HOLDS:
            nominal = {FAILS: NOMINAL, NO_IOTA: NO_IOTA_THERE}.get(verdict, OPEN)
            found = RobustVerdict(nominal, self._margin(signs, iota), {})
            return found, found
        margins = self._margins(signs, iota)
        return (
            self._as_sampled(uncertainty.over_box(margins, signs, relevant & known)),
            self._as_sampled(uncertainty.over_ellipsoid(margins, signs, features)),
        )

    def _as_sampled(self, found: RobustVerdict) -> RobustVerdict:
        """What holds at the sampled attitudes is not proved for all of them."""
        sampled = self.channel is None and len(self.problem.few_inverses) > 1
        return replace(found, verdict=SAMPLED) if sampled and found.verdict == ALL else found

    def _margins(self, signs: SignSet, iota: float | None) -> Callable[[Array], Array]:
        """Margins of many parameters at once; one that a side alone decides comes as a single number."""
        problem, i = self.problem, self.channel

        def margins(theta: Array) -> Array:
            if i is not None:
                quantities = [problem.channel_quantities(signs, i, iota, theta)]
            else:
                quantities = [problem.quantities(signs, J, iota, theta) for J in problem.few_inverses]
            found = [np.broadcast_to(self.condition.margin(q), len(theta)) for q in quantities]
            return np.asarray(np.min(found, axis=0))

        return margins

    def _features(self, signs: SignSet) -> tuple[Flags, Array]:
        """Which parameters the margin depends on, and through which combinations of them."""
        matrices = [m for name, m in (("M", signs.M), ("D", signs.D)) if name in self.condition.uses]
        if not matrices or not len(signs.names):
            return np.zeros(len(signs.names), dtype=bool), np.zeros((0, len(signs.names)))
        if self.channel is None:
            relevant = np.any([np.abs(m.slopes).max(axis=(1, 2)) > 0 for m in matrices], axis=0)
            return relevant, np.eye(len(signs.names))[relevant]
        features = np.array([m.slopes[:, self.channel, self.channel] for m in matrices])
        return np.any(features != 0, axis=0), features


def _worst_attitude(certificate: Certificate) -> str:
    if not certificate.worst:
        return certificate.proof
    angles = ", ".join(f"{a} = {np.degrees(v):.3g} deg" for a, v in certificate.worst.items())
    return f"least near {angles}; {certificate.proof}"
