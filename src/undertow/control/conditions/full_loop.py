"""The whole loop, with what no condition knows: linearised at its rest, and tried by simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from undertow.control.gains import GainSet, allocation_of
from undertow.control.laws import DISCONTINUOUS, LAMBDA, LAWS
from undertow.errors import UndertowError
from undertow.model.composition import function_of
from undertow.model.vehicle import Vehicle
from undertow.observer.design import Design
from undertow.typing import Array, Progress

from .attitude import ANGLES
from .check import check
from .problem import Problem, Uncertainty
from .result import SETTINGS, FullLoop, Region, Report

if TYPE_CHECKING:
    from undertow.control.linear.systems import LinearLoop


def certify(
    gains: GainSet,
    uncertainty: Uncertainty | None = None,
    *,
    observer: Design | None = None,
    progress: Progress = lambda done, summary: None,
    **options: Any,
) -> Report:
    """As `check`, which has the options, with the whole loop where effects or axes are outside conditions.

    With an observer also the loop in which the law gets its estimate; conditions are for true states.
    """
    report = check(gains, uncertainty, progress=progress, **options)
    progress(0.9, "the whole loop")
    if observer is not None:
        report = replace(report, loop_with_observer=observed_loop(gains, observer))
    if not (report.zero_dynamics or report.not_covered):
        return report
    return replace(report, full_loop=full_loop(gains, report.region))


def verdicts(gains: GainSet) -> dict[str, tuple[str, float | None]]:
    """Verdict and margin by condition; the margin only of what is derived from the model."""
    report = certify(gains)
    found: dict[str, tuple[str, float | None]] = {}
    for r in report.rows:
        where = " ".join(filter(None, (r.scope, r.signs)))
        margin = r.margin if r.form == "derived" else None
        found[f"{r.form} condition {r.condition}, {where}"] = (r.verdict, margin)
    for a in report.agreements:
        found[f"{a.form} conditions with one iota"] = (a.verdict, None)
    found["certified region"] = (report.region.kind, report.region.level)
    if report.full_loop is not None:
        found["whole loop"] = (report.full_loop.verdict, None)
    return found


def full_loop(gains: GainSet, region: Region) -> FullLoop:
    """The loop of a law with everything in its vehicle: effects, sensors, limits, axes that nothing pushes.

    It is linearised at rest at several headings and in all directions of motion that have parameters of their
    own, dead time as a Padé approximation; the law gets what the sensors report. Then it is simulated from
    starts within the region, or near the set-point where there is none.
    """

    def verdict() -> FullLoop:
        loops = [*_loops(gains)]
        worst = _worst(loops)
        return _simulated(gains, region, worst, loops[0][1].pose_offset) if worst.stable else worst

    return _verdict_or_error(verdict)


def observed_loop(gains: GainSet, observer: Design) -> FullLoop:
    """The loop in which a law gets the estimate of an observer, as it settles: linearised as `full_loop`."""
    return _verdict_or_error(lambda: _worst([*_loops(gains, observer)]))


def _worst(loops: Sequence[tuple[_Case, LinearLoop]]) -> FullLoop:
    found = [_linear_verdict(case, loop) for case, loop in loops]
    return max(found, key=lambda w: (w.verdict == "unstable", not w.stable, _growth(w)))


def _verdict_or_error(verdict: Callable[[], FullLoop]) -> FullLoop:
    try:
        return verdict()
    except UndertowError as error:
        return FullLoop("not judged", None, f"not judged: {error}")
    except np.linalg.LinAlgError as error:
        return FullLoop("not judged", None, f"not judged: linear algebra fails on these numbers ({error})")


def _growth(found: FullLoop) -> float:
    return -math.inf if found.pole is None else found.pole.real


# --- linearised -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Case:
    """A rest that the loop is linearised at."""

    held: Mapping[str, float]
    direction: Mapping[str, int]  # of motion, by velocity
    unactuated: int  # how many axes nothing pushes

    @property
    def where(self) -> str:
        heading = f"heading {math.degrees(self.held['psi']) % 360:.0f} deg" if "psi" in self.held else ""
        way = {1: "forward", -1: "backward"}.get(next(iter(self.direction.values()), 0), "")
        return ", ".join(filter(None, (heading, way)))


def _loops(gains: GainSet, observer: Design | None = None) -> Iterator[tuple[_Case, LinearLoop]]:
    from undertow.control.linear.numeric import Numeric, in_direction, reversing
    from undertow.control.linear.systems import LinearLoop, law_for, linear_with_delays
    from undertow.control.linear.trim import find_trim

    smooth, vehicle = _without_jump(gains), _with_limits(gains)
    reversing_velocities = reversing(vehicle)
    for sign in (1, -1) if reversing_velocities else (1,):
        direction = dict.fromkeys(reversing_velocities, sign)
        numeric = Numeric(in_direction(vehicle, direction))
        law = law_for(smooth, gains.plant.vehicle, direction)
        for held in _equilibria(gains):
            trim = find_trim(vehicle, held, direction=direction, numeric=numeric)
            loop = LinearLoop(
                linear_with_delays(numeric, trim, SETTINGS.pade_order),
                law,
                trim,
                observer,
                SETTINGS.pade_order,
            )
            yield _Case(held, direction, len(gains.unactuated)), loop


def _with_limits(gains: GainSet) -> Vehicle:
    """The vehicle whose thrusters have the limits that the gain file states."""
    vehicle, limits = gains.plant.vehicle, allocation_of(gains).limits
    limits_of = dict(zip(vehicle.command_names, map(float, limits), strict=True))
    thrusters = [
        replace(t, limit=limits_of[t.name]) if math.isfinite(limits_of[t.name]) else t
        for t in vehicle.thrusters
    ]
    return replace(vehicle, thrusters=tuple(thrusters))


def _without_jump(gains: GainSet) -> GainSet:
    """A law that jumps with a thin layer in its place: on its surface both lead to the same motion.

    With effects beside, a jump ends in a limit cycle that no linear loop shows: an error.
    """
    if gains.law.id not in DISCONTINUOUS:
        return gains
    if gains.plant.left_out:
        raise UndertowError(
            f"law '{gains.law.id}' is discontinuous at its set-point: with {', '.join(gains.plant.left_out)} "
            "it has no linearisation there; use 'sliding-mode-boundary-layer'"
        )
    values, drive = dict(gains.values), DISCONTINUOUS[gains.law.id]
    for c in gains.signals.coordinates:
        driven = bool(values[f"{drive}_{c}"])
        speed = SETTINGS.layer_speed * values[str(LAMBDA.symbol(c))]
        values[f"width_{c}"] = 1.0 / speed if driven else 1.0
        values[f"K_Z_{c}"] = float(driven)
    return replace(gains, law=LAWS["sliding-mode-boundary-layer"](), values=values)


def _equilibria(gains: GainSet) -> Iterator[dict[str, float]]:
    """What is held at each rest to look at: no velocity, an even keel where the law keeps it, a heading."""
    vehicle = gains.plant.vehicle
    rest: dict[str, float] = dict.fromkeys(vehicle.velocity_names, 0.0)
    pairs = zip(vehicle.pose_names, vehicle.degrees_of_freedom, strict=True)
    rest |= {c: 0.0 for c, dof in pairs if c in ("phi", "theta") and dof not in gains.unactuated}
    if "psi" not in vehicle.pose_names:
        yield rest
        return
    differs = gains.plant.left_out or gains.unactuated or Problem(gains).heading_matters
    for k in range(SETTINGS.headings if differs else 1):
        yield {**rest, "psi": math.remainder(2 * math.pi * k / SETTINGS.headings, 2 * math.pi)}


def _linear_verdict(case: _Case, loop: LinearLoop) -> FullLoop:
    from scipy.linalg import matrix_balance

    # A of the closed loop without integrals that nothing depends on.
    system, law_states = loop.closed, set(loop.law.state_labels)
    kept = list(range(system.nstates))
    for i, name in enumerate(system.state_labels):
        if name in law_states and not np.any(np.delete(system.A[:, i], i)) and not np.any(system.C[:, i]):
            kept.remove(i)
    matrix = np.asarray(system.A[np.ix_(kept, kept)])
    poles = np.linalg.eigvals(matrix)
    worst = complex(max(poles, key=lambda p: (p.real, p.imag)))
    if worst.real > SETTINGS.slowest_decay:
        return FullLoop("unstable", worst, case.where)
    undamped = int(np.sum(poles.real >= -SETTINGS.slowest_decay))
    # Rank after balancing, so that states of small and large numbers count alike.
    balanced, _ = matrix_balance(matrix)
    singular = np.linalg.svd(balanced, compute_uv=False)
    rank_deficiency = len(matrix) - int(np.sum(singular > SETTINGS.rank * singular[0]))
    if case.unactuated and undamped > rank_deficiency:
        text = f"an unactuated motion, or the integral of its error, diverges ({case.where or 'at rest'})"
        return FullLoop("unstable", worst, text)
    if undamped > case.unactuated:
        text = f"not judged: a motion neither decays nor grows ({case.where or 'at rest'}); a dead band, say"
        return FullLoop("not judged", worst, text)
    decaying = [complex(p) for p in poles if p.real < -SETTINGS.slowest_decay]
    slowest = max(decaying, key=lambda p: (p.real, p.imag), default=worst)
    return _with_offset(FullLoop("stable", slowest, case.where), loop)


def _with_offset(found: FullLoop, loop: LinearLoop) -> FullLoop:
    """How far from its set-point the loop comes to rest: no integral, or a sensor with a constant error."""
    offset = loop.pose_offset
    offsets = {c: v for c, v in offset.items() if abs(v) > SETTINGS.largest_offset}
    if not offsets:
        return replace(found, offset=offset)
    errors = ", ".join(f"{abs(v):.3g} {'rad' if c in ANGLES else 'm'} in {c}" for c, v in offsets.items())
    text = f"it comes to rest {errors} off its set-point ({found.text or 'at rest'})"
    return FullLoop("off the set-point", found.pole, text, offset)


# --- tried by simulation --------------------------------------------------------------------------
def _simulated(gains: GainSet, region: Region, found: FullLoop, rest: Mapping[str, float]) -> FullLoop:
    """The verdict after simulations of the whole loop; a start that it does not come back from refutes it."""
    from undertow.control.closed_loop.scenario import Scenario
    from undertow.control.closed_loop.simulate import ClosedLoop, Runs

    starts = _starts(gains, region)
    slowest = -found.pole.real if found.pole is not None else 1.0
    duration = float(
        np.clip(SETTINGS.time_constants / max(slowest, SETTINGS.slowest_decay), *SETTINGS.durations)
    )
    loop = ClosedLoop(gains)

    def run(dt: float) -> Runs:
        scenario = Scenario(tuple(0.0 for _ in gains.signals.coordinates), duration, dt)
        return loop.run_many(scenario, starts={c: v + rest[c] for c, v in starts.items()})

    try:
        runs = run(SETTINGS.dt)
    except UndertowError:
        runs = run(SETTINGS.dt / SETTINGS.finer)
    residuals = _residual_errors(gains, runs.states[:, -1], rest, starts)
    worst = int(np.argmax(residuals))
    # A loop too slow for the longest simulation has to do what its slowest pole says, with some slack.
    allowed = max(SETTINGS.largest_residual, SETTINGS.pole_slack * math.exp(-slowest * duration))
    summary = f"{len(residuals)} starts at rest, errors of {_error_sizes(starts)}, {duration:.0f} s each"
    if not residuals[worst] <= allowed:
        start = ", ".join(f"{n} = {float(v[worst] + rest[n]):.3g}" for n, v in starts.items())
        text = f"simulated for {duration:.0f} s from {start} it does not come back"
        return replace(found, verdict="unstable", pole=None, text=text, simulated=summary)
    return replace(found, simulated=f"{summary}: all come back")


def _error_sizes(starts: Mapping[str, Array]) -> str:
    """How far off the starts are, in words."""
    sizes = {c: float(np.abs(values).max()) for c, values in starts.items()}
    return ", ".join(
        f"{c} {math.degrees(v):.3g} deg" if c in ANGLES else f"{c} {v:.3g} m" for c, v in sizes.items()
    )


def _starts(gains: GainSet, region: Region) -> dict[str, Array]:
    """Corners of the errors that the region allows, at most a metre and half a radian, signs mixed."""
    rng = np.random.default_rng(SETTINGS.simulated_starts)
    most = {c: (0.5 if c in ANGLES else 1.0) for c in gains.signals.coordinates}
    share = 1 / math.sqrt(len(most))  # a corner of a box within an ellipsoid of V
    return {
        c: rng.choice((-1.0, 1.0), SETTINGS.simulated_starts) * min(m, share * region.errors.get(c, math.inf))
        for c, m in most.items()
    }


def _residual_errors(
    gains: GainSet, states: Array, rest: Mapping[str, float], starts: Mapping[str, Array]
) -> Array:
    """Largest error at the end, from where the loop rests, of pushed axes, in units of the start's."""
    plant, names = gains.plant, gains.signals.coordinates
    inverse = function_of(list(plant.eta), plant.J_inverse.tolist())
    actuated = [i for i, d in enumerate(plant.vehicle.degrees_of_freedom) if d not in gains.unactuated]
    angular = np.array([c in ANGLES for c in names])
    first = np.abs([starts[c][0] for c in names])
    scale = np.array([max(first[angular == is_angle]) for is_angle in angular])
    error = states[:, : len(names)] - np.array([rest[c] for c in names])
    error = np.where(angular, (error + np.pi) % (2 * np.pi) - np.pi, error)
    found = []
    for pose, residual in zip(states, error, strict=True):
        body = np.array(inverse(*pose[: len(names)]), dtype=float) @ residual
        found.append(np.max(np.abs(body / scale)[actuated]))
    return np.nan_to_num(found, nan=np.inf)
