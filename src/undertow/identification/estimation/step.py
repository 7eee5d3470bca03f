"""One bounded least-squares step: physical bounds, priors, step limits, constraints of the user."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear, nnls

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.model.parameter import Parameter, printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .data import WeakData
from .pointwise import Cut
from .residual import Linearised, WeakModel, base_name


@dataclass(frozen=True)
class StepSettings:
    """Numbers that a bounded step depends on."""

    # Standard deviations of a stated prior that it is widened by: it holds what the data leave open, and at
    # five it does not bias what they determine.
    prior_width: float = 5.0
    # Standard deviation of the default prior, as a share of the largest value that counts as possible: 0.6
    # for added mass in units of the inertia. It is widened likewise: what data determine moves by a hundredth
    # of its standard error or less.
    default_deviation: float = 0.06
    # Times its own size, its starts, or one SI unit, that a parameter which is not linear moves in one step.
    largest_step: float = 10.0
    # The same as a share of the distance of its bounds: a tether may come from far away.
    share_of_bounds: float = 0.02
    # Square of what a parameter changes over the distance of its bounds, or one SI unit if that is more, in
    # units of the noise, below which there is nothing but rounding: coefficients of ships reach 1e17 in SI.
    no_effect: float = 1e-24
    # Cutting planes that a step may need; each is a direction of a matrix of at most six motions.
    most_cuts: int = 60
    # Norm of the residual of the dual problem below which no step satisfies all inequalities.
    infeasible: float = 1e-9
    # Standard error, in the SI unit, from which the data do not determine a parameter: far beyond any value
    # of a ship, and far below the 1e50 and more that the inverse of no information gives.
    undetermined: float = 1e24
    # Relative distance, of values of at least the second number, SI, up to which a value is at its bound.
    at_bound: float = 1e-9
    least_size: float = 1e-6
    # Added to the diagonal of scaled normal equations, whose entries are one, to keep them regular.
    ridge: float = 1e-11
    step_tolerance: float = 1e-12  # of the bounded step, in scaled parameters
    bisections: int = 40  # of a step that would make the model unphysical: its share to 1e-12


SETTINGS = StepSettings()
PRIOR_WIDTH, UNDETERMINED = SETTINGS.prior_width, SETTINGS.undetermined


def bounds_of(model: WeakModel) -> tuple[Array, Array]:
    """Physical bounds of the free parameters, SNAME signs; those of what is tied to one count for it too.

    A vehicle of this mass, inertia and length allows no larger magnitudes, unless a standard deviation is
    stated that reaches farther.
    """
    table = np.array([_joint_bounds(model, base_name(name)) for name in model.free]).reshape(-1, 2)
    values = [model.functions.vehicle.value_of(base_name(n)) for n in model.free]
    stated = np.array([abs(v.value) + PRIOR_WIDTH * (v.sigma or 0.0) for v in values])
    largest = np.maximum(model.largest, stated)
    return np.maximum(table[:, 0], -largest), np.minimum(table[:, 1], largest)


def _joint_bounds(model: WeakModel, name: str) -> tuple[float, float]:
    low, high = _bounds(model, name)
    for other, factor in model.functions.followers(name).items():
        ends = sorted(bound / factor for bound in _bounds(model, other))
        low, high = max(low, ends[0]), min(high, ends[1])
        if low > high or (low == high == 0.0):
            raise UndertowError(
                f"{other} = {factor:g} {name} leaves no physical value for both: check the sign of the factor"
            )
    return low, high


def _bounds(model: WeakModel, name: str) -> tuple[float, float]:
    vehicle = model.functions.vehicle
    low, high = vehicle.declaration(name).bounds
    value = vehicle.value_of(name).value
    # A value that the user allowed against its sign keeps its freedom.
    return (min(low, value) if value else low, max(high, value) if value else high)


def check_known_leaders(model: WeakModel) -> None:
    """Refuse a parameter that is tied to a known one and is not physical by that."""
    vehicle = model.functions.vehicle
    for name, (other, factor) in model.functions.equal.items():
        value, (low, high) = factor * vehicle.value_of(other).value, _bounds(model, name)
        if other not in model.free and not low <= value <= high:
            raise UndertowError(
                f"{name} = {factor:g} {other} makes {name} {value:g} (SI, SNAME signs), but it must lie "
                f"between {low:g} and {high:g}: check the factor and its sign"
            )


def at_bounds(model: WeakModel, p: Array) -> dict[str, float]:
    """Free parameters that are at a limit of what is physical, with that limit."""
    low, high = bounds_of(model)
    values = p[list(model.places)]
    slack = SETTINGS.at_bound * np.maximum(np.abs(values), SETTINGS.least_size)
    below, above = values - low <= slack, high - values <= slack
    ends = np.where(below, low, high)
    return {n: float(e) for n, e, hit in zip(model.free, ends, below | above, strict=True) if hit}


def prior_of(model: WeakModel) -> tuple[Array, Array]:
    """Where stated priors are and how much they weigh."""
    values = [model.functions.vehicle.value_of(base_name(n)) for n in model.free]
    # A value without a stated error is not a prior, and may be infinite (a limit that is not there).
    centre = np.array([0.0 if v.sigma is None else v.value for v in values])
    weight = np.array([0.0 if v.sigma is None else 1.0 / (PRIOR_WIDTH * v.sigma) for v in values])
    for k, name in enumerate(model.free):
        for other, factor in model.functions.followers(name).items():
            stated = model.functions.vehicle.value_of(other)
            if stated.sigma is not None:
                by_other = stated.value / factor, abs(factor) / (PRIOR_WIDTH * stated.sigma)
                centre[k], weight[k] = _combined_prior((centre[k], weight[k]), by_other)
    return centre, weight


def search_prior(model: WeakModel) -> tuple[Array, Array]:
    """Where a search is drawn to, and how much: stated priors, and for the rest a weak one.

    That lies at the stated value, as wide as the size of the vehicle allows. It stops a parameter where the
    data do not determine it; where they do, it hardly moves it. It is not information: standard errors do
    not include it.
    """
    centre, weight = prior_of(model)
    weak = default_weights(model)
    return np.where(weak > 0.0, _values(model), centre), weight + weak


def default_weights(model: WeakModel) -> Array:
    """Weight of the default prior of every free parameter; zero where one is stated, or none follows."""
    deviation = PRIOR_WIDTH * SETTINGS.default_deviation * model.largest
    return np.where(prior_of(model)[1] > 0.0, 0.0, 1.0 / deviation)


def prior_distance(model: WeakModel, p: Array) -> Array:
    """Distance of the free parameters from what is stated, in standard deviations, stated or by default."""
    return np.asarray(PRIOR_WIDTH * search_prior(model)[1] * np.abs(p[list(model.places)] - _values(model)))


def _values(model: WeakModel) -> Array:
    """Stated values of the free parameters; zero for a limit that is not there."""
    return np.nan_to_num(
        [model.functions.vehicle.value_of(base_name(n)).value for n in model.free], posinf=0.0
    )


def prior_cost(prior: tuple[Array, Array], values: Array) -> float:
    """What priors add to the sum of squares at these values of the free parameters."""
    centre, stiffness = prior
    return float(np.sum((stiffness * (values - centre)) ** 2))


Prior = tuple[Array | float, Array | float]


def _combined_prior(first: Prior, second: Prior) -> tuple[Array, Array]:
    """Two priors as one: centres, and one over their standard deviations."""
    square = first[1] ** 2 + second[1] ** 2
    mean = first[1] ** 2 * first[0] + second[1] ** 2 * second[0]
    return mean / np.maximum(square, 1e-300), np.sqrt(square)


def step_limits(model: WeakModel) -> Array:
    """How far each free parameter moves at least in one step; without end for one that is linear.

    Where the data hardly depend on one, the linearised problem would send it to its bound.
    """
    vehicle = model.functions.vehicle
    return np.array([_step_limit(vehicle.declaration(base_name(n))) for n in model.free])


def _step_limit(parameter: Parameter) -> float:
    if parameter.linear:
        return np.inf
    span = parameter.bounds[1] - parameter.bounds[0]
    wide = SETTINGS.share_of_bounds * span if np.isfinite(span) else 0.0
    return max(SETTINGS.largest_step * max(1.0, *map(abs, parameter.starts), 0.0), wide)


def within_limits(bounds: tuple[Array, Array], now: Array, limits: Array) -> tuple[Array, Array]:
    """Bounds of the next step: a parameter moves no farther than its limit, or some times its own size."""
    limits = np.maximum(limits, SETTINGS.largest_step * np.abs(now))
    return np.maximum(bounds[0], now - limits), np.minimum(bounds[1], now + limits)


class SearchSpace:
    """Where the free parameters of a model may go, for every estimator: bounds, priors, step limits.

    The estimators share the step, its bounds and the priors. How a step is kept short differs, because their
    residuals do: output error, whose simulations may diverge, and the weak form, which tries the full
    Gauss-Newton step first, damp it (Levenberg-Marquardt); prediction error, which reestimates the noise
    after every step, shortens it until the cost falls; instrumental variables solve equations and have no sum
    of squares to watch. Only the weak form, which starts far away, needs step limits.
    """

    def __init__(
        self, model: WeakModel, *, limited: bool = False, known: tuple[Array, Array] | None = None
    ) -> None:
        """Take what is `known` from elsewhere as a prior, too: values and one over their standard errors."""
        self.model, self.places = model, list(model.places)
        self.bounds, self.prior = bounds_of(model), search_prior(model)
        if known is not None:
            self.prior = _combined_prior(self.prior, known)
        self._priors = self.prior
        self._limits = step_limits(model) if limited else None

    def scale_priors(self, inflation: float) -> None:
        """Let priors have their proper weight if residuals are correlated.

        Residuals count one each although so many (`Reduced.inflation`) are redundant: the residual of a poor
        model would otherwise move a mass ten standard deviations from its stated value, and hide the missing
        effect.
        """
        centre, weight = self._priors
        self.prior = centre, weight * np.sqrt(inflation)

    def nearest(self, p: Array) -> Array:
        """All parameters, the free ones moved as little as makes the model physical."""
        return nearest_physical(self.model, self.after_step(p, np.zeros(len(self.places))), self.bounds)

    def step(self, at: Linearised, p: Array) -> Array:
        """Bounded Gauss-Newton step of the free parameters after which the model is physical."""
        bounds = self.bounds
        if self._limits is not None:
            bounds = within_limits(bounds, p[self.places], self._limits)
        return limited_step(self.model, at, p, bounds, self.prior)

    def after_step(self, p: Array, step: Array) -> Array:
        """All parameters after a step of the free ones, which stay within their bounds."""
        after = p.copy()
        after[self.places] = np.clip(p[self.places] + step, *self.bounds)
        return after

    def cost(self, p: Array, squares: float) -> float:
        """A sum of squares with what priors add to it."""
        return squares + prior_cost(self.prior, p[self.places])

    def predicted_cost(self, p: Array, step: Array, r: Array) -> float:
        """Cost after a step that leaves the residual r of the linearised problem."""
        return squared(r) + prior_cost(self.prior, p[self.places] + step)


def damped(r: Array, J: Array, damping: float) -> Linearised:
    """The linearised problem with damped steps, relative to how well each parameter is determined."""
    hold = np.diag(np.sqrt(damping) * np.linalg.norm(J, axis=0))
    r, J = np.concatenate([r, np.zeros(len(hold))]), np.vstack([J, hold])
    return Linearised(r, J, np.zeros((len(r), 0)))


def squared(r: Array) -> float:
    """Sum of squares."""
    return float(np.sum(r**2))


def limited_step(
    model: WeakModel, at: Linearised, p: Array, bounds: tuple[Array, Array], prior: tuple[Array, Array]
) -> Array:
    """Bounded least-squares step after which the model is physical: its mass matrix positive, and the like.

    A direction in which a matrix would be negative becomes an inequality, and the step is made again; that
    converges to the solution under the matrix inequality. Without a violation it is the plain bounded step.
    """
    now, limits = p[list(model.places)], model.limits
    step = bounded_step(at, now, bounds, prior)
    cuts: list[Cut] = []
    while len(cuts) < SETTINGS.most_cuts and (found := limits.cuts(limits.after_step(p, step))):
        cuts += [Cut(c.slope, c.limit + float(c.slope @ step)) for c in found]
        step = bounded_step(at, now, bounds, prior, cuts)
    return _shortened(model, p, step) if cuts else step


def _shortened(model: WeakModel, p: Array, step: Array) -> Array:
    """The largest share of a step that leaves the model physical; all of it where it was not before."""
    limits = model.limits
    if limits.violated(p) or not limits.violated(limits.after_step(p, step)):
        return step
    good, bad = 0.0, 1.0
    for _ in range(SETTINGS.bisections):
        middle = (good + bad) / 2
        good, bad = (good, middle) if limits.violated(limits.after_step(p, middle * step)) else (middle, bad)
    return good * step


def nearest_physical(model: WeakModel, p: Array, bounds: tuple[Array, Array]) -> Array:
    """The parameters themselves where the model is physical with them, else the nearest for which it is."""
    if not model.limits.violated(p):
        return p
    now = p[list(model.places)]
    scale = np.diag(1.0 / np.maximum(np.abs(now), 1e-3))
    at = Linearised(np.zeros(len(now)), scale, np.zeros((len(now), 0)))
    nothing = np.zeros(len(now)), np.zeros(len(now))
    return model.limits.after_step(p, limited_step(model, at, p, bounds, nothing))


def bounded_step(
    at: Linearised,
    now: Array,
    bounds: tuple[Array, Array],
    prior: tuple[Array, Array],
    cuts: Sequence[Cut] = (),
) -> Array:
    """Bounded least-squares step of the linearised problem; what does not affect the data stays as it is."""
    span = bounds[1] - bounds[0]
    reach = np.where(np.isfinite(span), np.maximum(span, 1.0), 1.0)
    observed = (np.sum(at.J**2, axis=0) + prior[1] ** 2) * reach**2 > SETTINGS.no_effect
    step = np.zeros(len(now))
    if observed.any():
        chosen = Linearised(at.r, at.J[:, observed], at.start)
        kept = [Cut(c.slope[observed], c.limit) for c in cuts]
        limits, stated = ((a[observed], b[observed]) for a, b in (bounds, prior))
        step[observed] = _step(chosen, now[observed], limits, stated, kept)
    return step


def _step(
    at: Linearised, now: Array, bounds: tuple[Array, Array], prior: tuple[Array, Array], cuts: Sequence[Cut]
) -> Array:
    gram, slope = normal_equations(at, now, prior)
    if not (np.isfinite(gram).all() and np.isfinite(slope).all()):
        return np.zeros(len(now))  # unbounded states have no finite gradient
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram * np.outer(scale, scale) + SETTINGS.ridge * np.eye(len(now))
    factor = np.asarray(np.linalg.cholesky(scaled).T)
    target = np.asarray(np.linalg.solve(factor.T, -slope * scale))
    low, high = ((b - now) / scale for b in bounds)
    if cuts:
        table = np.array([c.slope * scale for c in cuts])
        least = np.array([c.limit for c in cuts])
        return _constrained(factor, target, low, high, table, least) * scale
    if np.all(np.isinf(low)) and np.all(np.isinf(high)):
        return np.linalg.solve(factor, target) * scale
    return _bounded(factor, target, low, high) * scale


def _bounded(factor: Array, target: Array, low: Array, high: Array) -> Array:
    """Bounded least squares; bounds that coincide are a little apart, as SciPy requires."""
    room = SETTINGS.step_tolerance
    found = lsq_linear(factor, target, bounds=(low - room, high + room), method="bvls", tol=room)
    return np.asarray(found.x)


def normal_equations(at: Linearised, now: Array, prior: tuple[Array, Array]) -> tuple[Array, Array]:
    """Information and slope of the sum of squares, stated priors included, at these values."""
    centre, stiffness = prior
    gram = at.J.T @ at.J + np.diag(stiffness**2)
    return gram, at.J.T @ at.r + stiffness**2 * (now - centre)


def _constrained(factor: Array, target: Array, low: Array, high: Array, table: Array, least: Array) -> Array:
    """Least squares under bounds and `table @ z >= least`, as a least distance problem.

    That is solved by non-negative least squares (Lawson and Hanson, Solving Least Squares Problems, 1974,
    chapter 23). Where no step satisfies all, the one that satisfies the bounds is returned.
    """
    unit = np.eye(len(target))
    rows = np.vstack([unit[np.isfinite(low)], -unit[np.isfinite(high)], table])
    limit = np.concatenate([low[np.isfinite(low)], -high[np.isfinite(high)], least])
    G = np.linalg.solve(factor.T, rows.T).T
    h = limit - G @ target
    size = np.linalg.norm(G, axis=1)
    G, h = G / size[:, None], h / size
    reach = max(float(np.max(h)), 1e-300)
    dual = np.vstack([G.T, h / reach])
    multiplier, rest = nnls(dual, np.append(np.zeros(len(target)), 1.0))
    if rest < SETTINGS.infeasible or np.max(h) <= 0.0:
        return _bounded(factor, target, low, high)
    missing = dual @ multiplier
    missing[-1] -= 1.0
    return np.linalg.solve(factor, target - reach * missing[:-1] / missing[-1])


def freed(vehicle: Vehicle, names: Iterable[str]) -> Vehicle:
    """The vehicle with these values to be estimated; itself where they are."""
    known = {n: vehicle.value_of(n) for n in names}
    opened = {n: replace(v, estimate=True) for n, v in known.items() if not v.estimate}
    return vehicle.with_values(opened) if opened else vehicle


def estimated(vehicle: Vehicle, values: Mapping[str, float], errors: Mapping[str, float]) -> Vehicle:
    """The vehicle with fitted values and their standard errors, SI and SNAME signs.

    Parameters without information in the data keep their stated error, if any.
    """
    found = {}
    for name, value in values.items():
        known = vehicle.value_of(name)
        sigma = errors[name] if errors[name] < UNDETERMINED else known.sigma
        found[name] = replace(known, value=value, sigma=sigma, estimate=True)
    return vehicle.with_values(found)


_NUMBER = r"[-+]?[\d.]+(?:[eE][-+]?\d+)?"
_EQUALITY = re.compile(rf"\s*(\w+)\s*=\s*(?:({_NUMBER})(?:\s*\*\s*|\s+))?([A-Za-z]\w*)\s*")


@dataclass(frozen=True)
class Constraints:
    """Constraints on the parameters of a fit, beside a mass matrix that is always positive definite."""

    # Parameters that are a multiple of another one: name to (name of the other, factor), SNAME signs
    equal: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    dissipative: bool = False  # Whether linear damping has to take energy from every motion, D + D' >= 0

    def model(self, vehicle: Vehicle, free: Sequence[str]) -> WeakModel:
        """The model of a vehicle with its free parameters, without those that follow others.

        Parameters that the vehicle's file ties to a free one follow it, marked or not.
        """
        equal = _resolved(self.equal, vehicle)
        kept = [n for n in free if n not in equal]
        vehicle = freed(vehicle, {other for other, _ in vehicle.follows.values()} & set(kept))
        model = WeakModel(Functions(vehicle, equal), kept, dissipative=self.dissipative)
        if equal:
            check_known_leaders(model)
            _require_physical(model)
        return model


def _require_physical(model: WeakModel) -> None:
    """Refuse equalities after which no values of the free parameters give a physical model."""
    p, bounds = np.array(model.functions.values(), dtype=float), bounds_of(model)
    places = list(model.places)
    p[places] = np.clip(p[places], *bounds)
    broken = model.limits.impossible(nearest_physical(model, p, bounds))
    if broken:
        tied = ", ".join(f"{n} = {factor:g} {other}" for n, (other, factor) in model.functions.equal.items())
        raise UndertowError(
            f"{tied} (SNAME signs) leaves no {broken[0]}: check the factors and their signs, or the known "
            "values"
        )


def _resolved(equal: Mapping[str, tuple[str, float]], vehicle: Vehicle) -> dict[str, tuple[str, float]]:
    """Every equality in terms of a parameter that follows no other."""
    found = {}
    for name in equal:
        other, factor = equal[name]
        for _ in equal:
            if other in equal:
                other, factor = equal[other][0], factor * equal[other][1]
        for one in (name, other):
            _require_parameter(one, vehicle)
        if other in equal or not factor or not np.isfinite(factor):
            raise UndertowError(
                f"{name} = {equal[name][1]:g} {equal[name][0]} ties a parameter to itself or to nothing: "
                "give each parameter once on the left side, with a finite, nonzero factor"
            )
        found[name] = (other, factor)
    return found


def _require_parameter(name: str, vehicle: Vehicle) -> None:
    if name not in vehicle.parameter_names:
        known = ", ".join(vehicle.parameter_names)
        raise UndertowError(
            f"'{name}' is not a parameter in the equations of '{vehicle.name}': they have {known}"
        )


def read_equalities(texts: Sequence[str], vehicle: Vehicle) -> dict[str, tuple[str, float]]:
    """Equalities such as ``Y_vdot = Z_wdot`` or ``N_r = 0.5 M_q``, in the signs of the vehicle's file."""
    found: dict[str, tuple[str, float]] = {}
    for text in texts:
        name, other, factor = _parsed(text)
        for one in (name, other):
            _require_parameter(one, vehicle)
        if name in found:
            raise UndertowError(f"{text!r}: {name} is on the left side twice")
        found[name] = (other, factor * _sign(other, vehicle) / _sign(name, vehicle))
    return found


def written_equalities(equal: Mapping[str, tuple[str, float]], vehicle: Vehicle) -> list[str]:
    """Equalities as `read_equalities` takes them."""
    signs = {n: _sign(other, vehicle) / _sign(n, vehicle) for n, (other, _) in equal.items()}
    return [f"{n} = {factor * signs[n]:.9g} {other}" for n, (other, factor) in equal.items()]


def _parsed(text: str) -> tuple[str, str, float]:
    match = _EQUALITY.fullmatch(text)
    if match is None:
        raise UndertowError(
            f"{text!r} is not an equality between two parameters: write Y_vdot = Z_wdot, or N_r = 0.5 M_q"
        )
    try:
        factor = float(match[2] or 1.0)
    except ValueError as error:
        raise UndertowError(f"{text!r}: {match[2]} is not a number") from error
    if not (np.isfinite(factor) and factor):
        raise UndertowError(f"{text!r}: the factor is {factor:g}: give a finite, nonzero one")
    return match[1], match[3], factor


def _sign(name: str, vehicle: Vehicle) -> float:
    """Sign of a parameter inside, where it is positive in the vehicle's file."""
    parameter = vehicle.parameter_of(name)
    return 1.0 if parameter is None else printed(parameter, 1.0, vehicle.signs)


def followers(model: WeakModel, values: Mapping[str, float]) -> dict[str, float]:
    """Values of the parameters that a fit ties to others, from those of the free ones."""
    f = model.functions
    known = {n: f.vehicle.value_of(n).value for n in f.parameter_names} | dict(values)
    return {name: factor * known[other] for name, (other, factor) in _tied_by_fit(f).items()}


def _tied_by_fit(f: Functions) -> dict[str, tuple[str, float]]:
    """Parameters tied by a constraint and not by the vehicle, whose values follow automatically."""
    return {name: pair for name, pair in f.equal.items() if name not in f.vehicle.tied}


def follower_errors(model: WeakModel, errors: Mapping[str, float]) -> dict[str, float]:
    """Standard errors of the parameters that are tied to others; zero where those are known."""
    tied = _tied_by_fit(model.functions).items()
    return {name: abs(factor) * errors.get(other, 0.0) for name, (other, factor) in tied}


# --- more equations than parameters ---------------------------------------------------------------
def require_equations(model: WeakModel, data: WeakData, method: str) -> None:
    """Refuse logs with no more weak equations of motion than parameters without a prior."""
    count = int(np.count_nonzero(data.equation < len(data.names) // 2))
    require_rows(model, count, data.runs, method)


def require_rows(model: WeakModel, count: int, runs: Sequence[Run], method: str) -> None:
    """Refuse as many equations as there are parameters without a prior, or fewer."""
    sought = int(np.count_nonzero(prior_of(model)[1] == 0.0))
    if sought and count <= sought:
        lengths = ", ".join(f"'{run.name}' {len(run.t)} samples" for run in runs)
        raise UndertowError(
            f"these logs ({lengths}) are too short for --method {method}: {sought} parameters need more than "
            f"{sought} equations, and they make {count}: give longer logs, or state parameters as known"
        )
