"""The checker: every condition of a law, on every set of parameters, with certificates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from undertow.control.gains import GainSet
from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .attitude import Certificate
from .by_law import Condition
from .channels import channel_polynomial, coupled_roots, reaching, roots, routh_array
from .lyapunov import equilibria_without_thrust, lyapunov
from .problem import (
    ALL,
    NO_IOTA_THERE,
    NOMINAL,
    OPEN,
    SAMPLED,
    Problem,
    Range,
    SignSet,
    Span,
    Uncertainty,
    inside,
    peak_of,
)
from .region import region
from .result import FAILS, HOLDS, NO_IOTA, UNPROVED, Agreement, Channel, Region, Report, Row
from .whole import left_alone, whole_loop

Tell = Callable[[float, str], None]
_MATRICES, _DERIVED = "matrices", "derived"


def check(
    gains: GainSet,
    uncertainty: Uncertainty,
    *,
    forms: Sequence[str] = (),
    iota: float | None = None,
    tilt: float = np.pi / 3,
    whole: bool = True,
    tell: Tell = lambda done, words: None,
) -> Report:
    """Check the gains of a law against every condition.

    Parameters
    ----------
    gains : GainSet
        Law, numbers and vehicle.
    uncertainty : Uncertainty
        How far the parameters of the vehicle are known.
    forms : sequence of str
        Which forms of conditions; all where none is named.
    iota : float, optional
        The constant of the PID conditions, 1/s; searched for when not given.
    tilt : float
        Largest roll and pitch that conditions have to hold for, rad.
    whole : bool
        Whether the loop with effects and axes that no condition knows is linearised and simulated, too.
    tell : callable
        Is told how much is done (0 to 1).

    Raises
    ------
    UndertowError
        If the mass matrix is not positive definite, or damping is not finite at rest.
    """
    everything = Problem(gains, tilt)
    problem = everything.of_forms(forms)
    _require_damping(problem)
    tell(0.1, "conditions")
    agreements = _agreements(problem, iota)
    rows = _rows(problem, uncertainty, iota, agreements, tell)
    tell(0.8, "Lyapunov function")
    equilibria = equilibria_without_thrust(gains.plant, gains.law)
    alone = left_alone(gains)
    own = _region(everything.of_forms([_DERIVED]), iota, rows, agreements)
    report = Report(
        vehicle=gains.plant.vehicle.name,
        gains=gains.name,
        law=gains.law.id,
        rows=(*rows, *(reaching(problem, uncertainty) if not forms or _DERIVED in forms else ())),
        agreements=tuple(agreements),
        channels=tuple(_channels(problem)),
        coupled=_coupled(problem),
        lyapunov=lyapunov(gains.plant, gains.law, equilibria),
        region=own,
        alone=alone,
        left_out=dict(gains.plant.left_out),
        uncertainty=f"{uncertainty.confidence:.0%}, from the {uncertainty.source}",
    )
    tell(0.9, "the whole loop")
    if not (whole and (alone or report.left_out)):
        return report
    return replace(report, whole=whole_loop(gains, own))


def _region(problem: Problem, iota: float | None, rows: list[Row], agreements: list[Agreement]) -> Region:
    """The region of a law whose derived conditions hold as matrices, over all attitudes and sign sets.

    `rows` and `agreements` are what was worked out; the derived ones are where other forms were asked for.
    """
    if problem.gains.unactuated:
        names = ", ".join(problem.gains.unactuated)
        return Region("none", f"none is certified: {names} is left alone, so that V may rise")
    own = [a for a in agreements if a.form == _DERIVED]
    derived = [r for r in rows if r.form == _DERIVED]
    if not derived:
        own = _agreements(problem, iota)
        derived = _rows(problem, Uncertainty(problem.plant.vehicle), iota, own)
    if any(r.verdict != HOLDS for r in derived) or any(a.verdict != HOLDS for a in own):
        return Region("none", "no region: the conditions derived from the model do not hold")
    span = next((a.iota for a in own), None)
    return region(problem, span if iota is None or span is None else (iota, iota))


def _require_damping(problem: Problem) -> None:
    needed = [c.statement for c in problem.conditions if "D" in c.uses]
    if needed and problem.plant.D.is_zero_matrix:
        raise UndertowError(
            f"'{problem.plant.vehicle.name}' has no damping, which the condition {needed[0]} is about: add "
            "[effects.linear_damping] or another effect of that family"
        )


# --- rows -------------------------------------------------------------------------------------
def _rows(
    problem: Problem,
    uncertainty: Uncertainty,
    iota: float | None,
    agreements: list[Agreement],
    tell: Tell = lambda done, words: None,
) -> list[Row]:
    spans = {a.form: a.iota for a in agreements}
    rows: list[Row] = []
    for k, condition in enumerate(problem.conditions):
        tell(0.1 + 0.7 * k / len(problem.conditions), condition.statement)
        found = [
            row
            for scope in _scopes(problem, condition)
            for row in _over_sets(
                _Place(problem, condition, scope, spans.get(condition.form), iota), uncertainty
            )
        ]
        rows += found
    return rows


def _scopes(problem: Problem, condition: Condition) -> list[int | None]:
    channels: list[int | None] = [] if condition.matrix_only else [*problem.driven]
    return channels if condition.per_channel_only else [None, *channels]


class _Place:
    """One condition at one scope: the matrices (None), or a channel by its number."""

    def __init__(
        self,
        problem: Problem,
        condition: Condition,
        channel: int | None,
        together: Span | None,
        iota: float | None,
    ) -> None:
        self.problem, self.condition, self.channel = problem, condition, channel
        self._together, self._given = together, iota

    def row(self, one: SignSet, uncertainty: Uncertainty) -> Row:
        span = self._span(one)
        iota = self._iota(one, span)
        left, right, certificate = self._sides(one, iota)
        condition = self.condition
        verdict = self._verdict(certificate, span)
        row = Row(
            condition.form,
            condition.id,
            condition.matrices if self.channel is None else condition.statement,
            condition.about,
            condition.source,
            _MATRICES if self.channel is None else self.problem.coordinates[self.channel],
            one.name,
            left,
            right,
            certificate.found,
            verdict,
            span,
            condition.uses_iota,
            iota,
            _where(certificate),
        )
        box, ellipsoid = self._ranges(one, iota, verdict, uncertainty)
        return replace(row, box=box, ellipsoid=ellipsoid)

    def _verdict(self, certificate: Certificate, span: Span | None) -> str:
        if certificate.found > 0:
            return HOLDS if certificate.bound > 0 else UNPROVED
        return NO_IOTA if self.condition.uses_iota and span is None else FAILS

    def _span(self, one: SignSet) -> Span | None:
        if not self.condition.uses_iota:
            return None
        return self.problem.iota([self.condition], [one], self.channel)

    def _iota(self, one: SignSet, span: Span | None) -> float | None:
        """The iota that serves all conditions if there is one, else one for this one, else the best."""
        if not self.condition.uses_iota:
            return None
        if self._given is not None:
            return self._given
        if self._together is not None:
            return inside(self._together)
        return inside(span) if span else peak_of(lambda i: self._margin(one, i))

    def _margin(self, one: SignSet, iota: float | None, theta: Array | None = None) -> float:
        if self.channel is None:
            return self.problem.margin(self.condition, one, iota, theta)
        return self.problem.channel_margin(self.condition, one, self.channel, iota, theta)

    def _sides(self, one: SignSet, iota: float | None) -> tuple[float, float, Certificate]:
        if self.channel is not None:
            left, right = self.condition.sides(self.problem.channel_signs(one, self.channel, iota))
            margin = self._margin(one, iota)
            return left, right, Certificate(margin, margin, {}, "")
        certificate = self.problem.certificate(self.condition, one, iota)
        inverse = self.problem.attitudes.at(certificate.worst)
        left, right = self.condition.sides(self.problem.signs(one, inverse, iota))
        return left, right, certificate

    # --- uncertainty
    def _ranges(
        self, one: SignSet, iota: float | None, verdict: str, uncertainty: Uncertainty
    ) -> tuple[Range | None, Range | None]:
        matters, features = self._features(one)
        known = np.diag(uncertainty.covariance(one.names)) > 0
        if not (matters & known).any():
            return None, None
        if verdict != HOLDS:
            nominal = {FAILS: NOMINAL, NO_IOTA: NO_IOTA_THERE}.get(verdict, OPEN)
            found = Range(nominal, self._margin(one, iota), {})
            return found, found

        def margins(theta: Array) -> Array:
            return np.array([self._margin(one, iota, row) for row in theta])

        batched = self._batched(one, iota) or margins
        return (
            self._honest(uncertainty.over_box(batched, one, matters & known)),
            self._honest(uncertainty.over_ellipsoid(batched, one, features)),
        )

    def _honest(self, found: Range) -> Range:
        """What holds at some attitudes only is not settled for all."""
        sampled = self.channel is None and len(self.problem.few_attitudes) > 1
        return replace(found, verdict=SAMPLED) if sampled and found.verdict == ALL else found

    def _batched(self, one: SignSet, iota: float | None) -> Callable[[Array], Array] | None:
        """All parameters at once; a margin that one side alone decides comes as a single number."""
        if self.channel is None:
            return lambda theta: np.min(
                [
                    np.broadcast_to(
                        self.condition.margin(self.problem.signs(one, J, iota, theta)), len(theta)
                    )
                    for J in self.problem.few_attitudes
                ],
                axis=0,
            )
        i = self.channel
        return lambda theta: np.broadcast_to(
            self.condition.margin(self.problem.channel_signs(one, i, iota, theta)), len(theta)
        )

    def _features(self, one: SignSet) -> tuple[Flags, Array]:
        """Which parameters the margin depends on, and through which combinations of them."""
        used = self.condition.uses
        parts = [m for name, m in (("M", one.M), ("D", one.D)) if name in used]
        if not parts or not len(one.names):
            return np.zeros(len(one.names), dtype=bool), np.zeros((0, len(one.names)))
        if self.channel is None:
            matters = np.any([np.abs(m.slopes).max(axis=(1, 2)) > 0 for m in parts], axis=0)
            return matters, np.eye(len(one.names))[matters]
        features = np.array([m.slopes[:, self.channel, self.channel] for m in parts])
        return np.any(features != 0, axis=0), features


def _over_sets(place: _Place, uncertainty: Uncertainty) -> list[Row]:
    """One row for all sets of parameters where they agree; a mixed set only where it is worse."""
    sets = place.problem.distinct
    rows = [place.row(one, uncertainty) for one in sets[:2]]
    if len(rows) == 2 and _alike(*rows):
        rows = [replace(rows[0], signs="both")]
    known = min(r.margin for r in rows)
    mixed = [place.row(one, uncertainty) for one in sets[2:]] if place.channel is None else []
    return rows + [r for r in mixed if r.margin < known - 1e-12 * abs(known) and r.verdict != HOLDS]


def _alike(one: Row, other: Row) -> bool:
    keys = ("left", "right", "margin", "iota", "verdict")
    same = all(getattr(one, k) == getattr(other, k) for k in keys)
    return same and (one.box and one.box.verdict) == (other.box and other.box.verdict)


def _where(certificate: Certificate) -> str:
    if not certificate.worst:
        return certificate.proof
    angles = ", ".join(f"{a} = {np.degrees(v):.3g} deg" for a, v in certificate.worst.items())
    return f"least near {angles}; {certificate.proof}"


def _agreements(problem: Problem, iota: float | None) -> list[Agreement]:
    found = []
    for form in dict.fromkeys(c.form for c in problem.conditions):
        own = [c for c in problem.conditions if c.form == form and not c.per_channel_only]
        if not any(c.uses_iota for c in own):
            continue
        span = problem.iota(own, problem.distinct)
        served = span is not None and (iota is None or span[0] < iota < span[1])
        found.append(Agreement(form, span, HOLDS if served else NO_IOTA if span is None else FAILS))
    return found


# --- linearised channels ----------------------------------------------------------------------
def _channels(problem: Problem) -> list[Channel]:
    found = []
    for i, axis, name in problem.channels:
        own = [_channel(problem, one, i, axis, name) for one in problem.sets[:2]]
        distinct = [c for c in own if c is not None]
        if len(distinct) == 2 and distinct[0].polynomial == distinct[1].polynomial:
            distinct = [replace(distinct[0], signs="both")]
        found += distinct
    return found


def _channel(problem: Problem, one: SignSet, i: int, axis: int, name: str) -> Channel | None:
    gains = {gain: float(v[i]) for gain, v in problem.values.items()}
    polynomial = channel_polynomial(gains, float(one.inertia[axis, axis]), float(one.damping[axis, axis]))
    if polynomial is None:
        return None
    first = [float(row[0]) for row in routh_array(polynomial)]
    found = roots(polynomial)
    stable = all(a * b > 0 for a, b in pairwise(first)) and found[0].real < 0
    return Channel(name, one.name, polynomial, first, found, stable)


def _coupled(problem: Problem) -> dict[str, list[complex]]:
    """Roots with all axes together, where M or D couple them or gains tell north from east.

    Of all headings, where they matter, the one with the root that grows fastest.
    """
    if (problem.decoupled and not problem.heading_counts) or "K_P" not in problem.values:
        return {}
    found = {}
    for one in problem.sets[:2]:
        tried = [
            (coupled_roots(problem.values, one.inertia, one.damping, problem.plant, J), degrees)
            for degrees, J in problem.headings
        ]
        roots_there, degrees = max(tried, key=lambda case: case[0][0].real)
        of = "" if not problem.heading_counts else f"worst of {len(tried)} headings: {degrees:.0f} deg"
        found[", ".join(filter(None, (one.name, of)))] = roots_there
    return found


_CERTIFIED_DERIVED = "derived"


def checked(gains: GainSet) -> Report:
    """The conditions on a gain set with the stated parameters of its vehicle."""
    return check(gains, Uncertainty(gains.plant.vehicle))


def certified(gains: GainSet) -> bool:
    """Whether every condition that is derived from the model holds, with one iota for all."""
    report = check(gains, Uncertainty(gains.plant.vehicle), forms=[_CERTIFIED_DERIVED], whole=False)
    rows = all(r.verdict == HOLDS for r in report.rows)
    return rows and all(a.verdict == HOLDS for a in report.agreements)


def told(gains: GainSet) -> dict[str, tuple[str, float | None]]:
    """Verdict and margin by condition; the margin only of what is derived from the model."""
    report = checked(gains)
    found: dict[str, tuple[str, float | None]] = {}
    for r in report.rows:
        where = " ".join(filter(None, (r.scope, r.signs)))
        found[f"{r.form} condition {r.condition}, {where}"] = (
            r.verdict,
            r.margin if r.form == _CERTIFIED_DERIVED else None,
        )
    for a in report.agreements:
        found[f"{a.form} conditions with one iota"] = (a.verdict, None)
    found["certified region"] = (report.region.kind, report.region.level)
    if report.whole is not None:
        found["whole loop"] = (report.whole.verdict, None)
    return found
