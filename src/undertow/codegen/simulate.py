"""Simulation of logs with exact sensitivities, by compiled code or by what there is in its place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from numbers import Real
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from undertow.errors import UndertowError, of_stated_kinds
from undertow.model.vehicle import Vehicle
from undertow.notebook import html
from undertow.typing import Array, Integers, number_array

from .compiler import Compiler, compiled_or_virtual
from .engine import (
    CompiledRollout,
    InterpretedModel,
    Problem,
    Products,
    Stepper,
    Tangents,
    carried,
    compiled_tangents,
    engine,
    in_threads,
    mapped,
    products_of,
    shares,
)
from .functions import Functions


@dataclass(frozen=True)
class StepSettings:
    """Settings of the Runge-Kutta steps of simulations."""

    per_call: int = 200_000  # steps (times runs) in one call; between calls Ctrl-C takes effect
    longest: float = 0.05  # longest step where the caller knows nothing of the motion, s
    # Time constants of friction and of states that effects own in a step: a decay by e^-0.7 in one step is
    # right to a quarter of a percent; past 2.8 it is unstable.
    reach: float = 0.7
    # What is faster than that many steps in one of the longest can follow is slurred, such as a lag of
    # milliseconds: then a step covers so many of its time constants. That is stable down to so many steps.
    most_parts: int = 16
    stable: float = 2.0
    most_steps: int = 20_000
    rounding: float = 1e-6  # of a step by which an interval may be longer than a whole number of them
    longest_run: float = 5e6  # s; two months are some 10^8 steps, which take a minute


SETTINGS = StepSettings()
LONGEST_STEP = SETTINGS.longest


class Simulator:
    """Simulates a vehicle over a log by fourth-order Runge-Kutta with inputs held between samples.

    With `compiled` the model is compiled, or it fails. Without, its instructions are run by a loop in C that
    is the same for all models, which begins at once and is slower. By default the model is compiled where a
    compiler is found; else its instructions are run, where a wheel brings that loop along, or else CasADi's
    virtual machine runs, and one logged line says so.
    """

    def __init__(self, functions: Functions, *, compiled: bool | None = None) -> None:
        self._functions = functions
        self._wish = compiled
        self._steppers: dict[tuple[int, ...], Stepper] = {}
        self._stepper(())

    @property
    def compiled(self) -> bool:
        """Whether compiled code runs."""
        return isinstance(self._stepper(()), CompiledRollout)

    def _stepper(self, wrt: tuple[int, ...]) -> Stepper:
        """What simulates with sensitivities in these parameters (-1 for initial states), made once."""

        def compiled(compiler: Compiler) -> Stepper:
            if wrt:
                return compiled_tangents(self._functions, wrt, compiler)
            return CompiledRollout(self._functions, compiler)

        def otherwise() -> Stepper:
            model = self._with_slopes if wrt else self._uncompiled(sensitivities=False)
            if model is not None:
                return model.tangents(wrt)
            return VirtualStepper(self._functions, wrt)

        if wrt not in self._steppers:
            self._steppers[wrt] = compiled_or_virtual(self._wish, compiled, otherwise)
        return self._steppers[wrt]

    @cached_property
    def _with_slopes(self) -> InterpretedModel | None:
        return self._uncompiled(sensitivities=True)

    def _uncompiled(self, *, sensitivities: bool) -> InterpretedModel | None:
        run = engine()
        return None if run is None else InterpretedModel(self._functions, run, sensitivities=sensitivities)

    # --- runs ---------------------------------------------------------------------------------
    def run(
        self,
        x0: Array,
        t: Array,
        u: Array,
        p: Array,
        *,
        max_step: float = LONGEST_STEP,
        threads: int | None = None,
    ) -> Array:
        """Simulate one run, or a batch of b runs side by side in the lanes of vectors and in threads.

        Parameters
        ----------
        x0, t, u, p : ndarray, shapes (nx,), (n,), (n, nu), (np,), or with b in front
            First states; times in s, not decreasing; inputs, u[i] held over [t[i], t[i+1]); parameters.
        max_step : float
            Longest Runge-Kutta step, s; dry friction and states that effects own (lags, memory) may ask for
            shorter ones.
        threads : int, optional
            How many for a batch; by default as many as there are processors.

        Returns
        -------
        ndarray, shape (n, nx) or (b, n, nx)
            States at the samples; NaN from the first sample on where a run has diverged.
        """
        problem = self._problem(x0, t, u, p, max_step)
        self._advance(problem, self._stepper(()), threads)
        return problem.x[0] if np.ndim(x0) == 1 else problem.x

    def run_with_sensitivities(
        self,
        x0: Array,
        t: Array,
        u: Array,
        p: Array,
        wrt: Sequence[int],
        *,
        initial: Sequence[int] = (),
        start_slopes: Array | None = None,
        max_step: float = LONGEST_STEP,
    ) -> tuple[Array, Array]:
        """Simulate and differentiate: exact derivatives of the discrete Runge-Kutta solution.

        As `run`, with derivatives in the parameters `wrt` and the initial values of the states `initial`, by
        index. Where the initial states depend on these parameters, `start_slopes`, (..., nx, len(wrt)), are
        their derivatives. Returns states, shape (..., n, nx), and their derivatives, parameters first, shape
        (..., n, nx, len(wrt) + len(initial)).
        """
        problem = self._problem(x0, t, u, p, max_step)
        first = _start_sensitivities(problem, list(wrt), list(initial), start_slopes)
        self._advance_with_sensitivities(problem, first, self._stepper(tuple(problem.wrt.tolist())))
        return (problem.x[0], problem.s[0]) if np.ndim(x0) == 1 else (problem.x, problem.s)

    def products(
        self,
        x0: Array,
        t: Array,
        u: Array,
        p: Array,
        wrt: Sequence[int],
        measured: Array,
        weight: Array,
        group: Integers,
        *,
        start_slopes: Array | None = None,
        max_step: float = LONGEST_STEP,
    ) -> Products:
        """Simulate windows and differentiate, keeping only the sums that a Gauss-Newton step needs.

        As `run_with_sensitivities`, of a batch of b runs; derivatives in the initial pose and velocity follow
        those in the parameters. `measured` has pose and velocity, `weight` what errors are multiplied with,
        zero for what does not count, shape (b, n, 2 dof) each; `group`, shape (b, n), says of which sum of
        its window a sample is part, counted from zero, never falling.
        """
        problem = self._problem(x0, t, u, p, max_step)
        size = 2 * self._functions.nu_dot.numel()
        known = np.ascontiguousarray(np.where(weight == 0, 0.0, measured), dtype=float)
        factors = np.ascontiguousarray(weight, dtype=float)
        groups = np.ascontiguousarray(group, dtype=np.int64)
        first = _start_sensitivities(problem, list(wrt), list(range(size)), start_slopes)
        stepper = self._stepper(tuple(problem.wrt.tolist()))
        if isinstance(stepper, Tangents):
            problem.s = first[:, None]
            return stepper.products(problem, known, factors, groups)
        self._advance_with_sensitivities(problem, first, stepper)
        return products_of(problem.x[..., :size], problem.s[..., :size, :], known, factors, groups)

    def _advance_with_sensitivities(self, problem: Problem, first: Array, stepper: Stepper) -> None:
        problem.s = np.zeros((*problem.x.shape, problem.wrt.size))
        problem.s[:, 0] = first
        self._advance(problem, stepper, 1)

    def _advance(self, problem: Problem, stepper: Stepper, threads: int | None) -> None:
        lanes = getattr(stepper, "lanes", 0)

        def simulate(part: Problem) -> None:
            for first, last in pairwise([0, *_interruptions(part), part.t.shape[1] - 1]):
                stepper.advance(part, first, last)

        if not lanes:
            simulate(problem)
            return
        work = problem.steps.sum(axis=1).max(initial=0)
        parts = [problem.part(runs) for runs in shares(len(problem.x), work, threads, lanes)]
        in_threads(simulate, parts, threads)

    @cached_property
    def _rate_dependencies(self) -> list[bool]:
        """Which of state, input, parameters and time make one run quicker than another."""
        return [self._functions.quickest.jac_sparsity(0, k).nnz() > 0 for k in range(4)]

    # --- input --------------------------------------------------------------------------------
    def _problem(self, x0: Array, t: Array, u: Array, p: Array, max_step: float) -> Problem:
        if not max_step > 0:
            raise UndertowError(f"max_step = {max_step:g} s is not a step: give a positive time")
        start, times, inputs, parameters = checked_runs(self._functions, x0, t, u, p)
        x = np.empty((len(start), times.shape[1], start.shape[1]))
        x[:, :1] = start[:, None]
        none = np.empty(0, dtype=np.int64)
        longest = self._resolving_step(start, times, inputs, parameters, max_step)
        return Problem(times, _steps(times, longest), inputs, parameters, x, none, np.empty((*x.shape, 0)))

    def _resolving_step(self, start: Array, t: Array, u: Array, p: Array, max_step: float) -> Array:
        """The longest step, in each run or in all, that follows friction and the states that effects own."""
        given = zip((start, u[:, 0], p, t[:, :1]), self._rate_dependencies, strict=True)
        at_first = [a if felt and a.strides[0] else a[:1] for a, felt in given]
        batch = max(map(len, at_first))
        state, inputs, parameters, now = (a if len(a) == batch else a[0] for a in at_first)
        when = np.broadcast_to(now.ravel(), batch)
        (slopes,) = mapped(self._functions.quickest, [state, inputs], parameters, when)
        return _longest(slopes, max_step)[:, None]


def longest_step(functions: Functions, max_step: float) -> float:
    """The longest Runge-Kutta step with the vehicle's own values, at rest without commands, s.

    It is `max_step` or what follows dry friction and the states that effects own, as in `Simulator.run`.
    """
    at_rest = functions.quickest(0, 0, functions.values(), 0)
    return float(_longest(np.asarray(at_rest)[None], max_step)[0])


def _longest(slopes: Array, max_step: float) -> Array:
    """The longest step, s, for each of the matrices of d(rates)/d(states)."""
    known = np.nan_to_num(slopes, posinf=0, neginf=0)
    rates = np.full(len(known), SETTINGS.reach / max_step)
    # No eigenvalue exceeds the norm: most runs need none worked out.
    stiff = np.abs(known).sum(axis=2).max(axis=1, initial=0.0) > rates
    rates[stiff] = np.maximum(rates[stiff], _fastest_decay(known[stiff]))
    usual = min(max_step, LONGEST_STEP)
    longest = np.maximum(SETTINGS.reach / rates, usual / SETTINGS.most_parts)
    slurred = np.maximum(SETTINGS.stable / rates, usual / SETTINGS.most_steps)
    return np.asarray(np.where(rates * longest <= SETTINGS.stable, longest, slurred))


def _fastest_decay(slopes: Array) -> Array:
    """Largest rate in each of the matrices, 1/s, but of what only grows: no step keeps that in bounds."""
    poles = np.linalg.eigvals(slopes)
    return np.asarray(np.where(poles.real > np.abs(poles.imag), 0.0, np.abs(poles)).max(axis=1, initial=0.0))


def _interruptions(problem: Problem) -> list[int]:
    """Samples at which a long simulation comes back to Python."""
    work = np.cumsum(problem.steps.max(axis=0, initial=1)) * len(problem.x)
    limits = np.arange(SETTINGS.per_call, work[-1] if work.size else 0, SETTINGS.per_call)
    return [int(i) for i in np.searchsorted(work, limits)]


def _steps(t: Array, max_step: Array) -> Integers:
    intervals = np.diff(t, axis=1)
    # An interval of exactly k steps stays k steps although its floating-point length may be a bit more.
    return np.maximum(np.ceil(intervals / max_step - SETTINGS.rounding), 1).astype(np.int64)


def _start_sensitivities(
    problem: Problem, wrt: list[int], initial: list[int], start_slopes: Array | None
) -> Array:
    """Derivatives of the initial states, (b, nx, len(wrt) + len(initial)); `problem.wrt` becomes theirs."""
    batch, _, nx = problem.x.shape
    for name, indices, size in (("wrt", wrt, problem.p.shape[1]), ("initial", initial, nx)):
        beyond = [i for i in indices if not 0 <= i < size]
        if beyond:
            raise UndertowError(f"{name} holds index {beyond[0]}, but there are {size}: give 0 to {size - 1}")
    problem.wrt = np.array([*wrt, *[-1] * len(initial)], dtype=np.int64)
    first = np.zeros((batch, nx, problem.wrt.size))
    if start_slopes is not None:
        first[..., : len(wrt)] = _checked("start_slopes", start_slopes, (nx, len(wrt)), batch)
    first[:, initial, np.arange(len(wrt), problem.wrt.size)] = 1.0
    return first


# --- what a simulation is given -------------------------------------------------------------------
def checked_runs(
    functions: Functions, x0: Array, t: Array, u: Array, p: Array
) -> tuple[Array, Array, Array, Array]:
    """The same with a leading size of the batch, or of one where the runs share it."""
    start = _checked("x0", x0, (len(functions.state_names),))
    batch = len(start)
    times = _checked("t", t, (None,), batch)
    samples = times.shape[1]
    if not samples:
        raise UndertowError("t holds no samples: give at least the time of the initial state")
    inputs = _checked("u", u, (samples, functions.u.numel()), batch)
    parameters = _checked("p", p, (functions.p.numel(),), batch)
    if not (np.isfinite(times).all() and (np.diff(times, axis=1) >= 0).all()):
        raise UndertowError(
            "times of the samples are not finite or go back: sort the log, drop samples without time"
        )
    return start, times, inputs, parameters


def _checked(name: str, array: Array, shape: tuple[int | None, ...], batch: int | None = None) -> Array:
    """The array as contiguous floats with a leading size of one or of the batch."""
    values = np.ascontiguousarray(array, dtype=float)
    if values.ndim == len(shape):
        values = values[None]
    fits = values.ndim == len(shape) + 1 and all(
        wanted in (None, size) for size, wanted in zip(values.shape[1:], shape, strict=True)
    )
    if not fits or (batch is not None and values.shape[0] not in (1, batch)):
        wanted = ", ".join("n" if s is None else str(s) for s in shape)
        runs = "" if batch is None else f" for each of {batch} runs"
        raise UndertowError(f"{name} has shape {np.shape(array)}: give ({wanted}){runs}")
    return values


# --- without compiled code -------------------------------------------------------------------------
# Of the stages of a step: where in the step, how often it counts in six, and how far on the next one is.
_STAGES = ((0.0, 1, 0.5), (0.5, 2, 0.5), (0.5, 2, 1.0), (1.0, 1, 0.0))


def runge_kutta(
    rates: Callable[[Sequence[Any], float], Sequence[Any]], state: Sequence[Any], h: Sequence[Any]
) -> list[Any]:
    """One step of the classical fourth-order Runge-Kutta method, on numbers or on CasADi's expressions.

    `rates` gives the time derivatives of the parts of a state at a part of the step; `h` has the length of
    the step in a form that each part can be multiplied with.
    """
    stage, total = state, [0.0] * len(state)
    for reach, weight, ahead in _STAGES:
        rate = rates(stage, reach)
        total = [a + weight * f for a, f in zip(total, rate, strict=True)]
        stage = [z + (ahead * step) * f for z, step, f in zip(state, h, rate, strict=True)]
    return [z + step / 6 * a for z, step, a in zip(state, h, total, strict=True)]


class VirtualStepper:
    """Runge-Kutta steps of one run after the other, by CasADi's virtual machine."""

    def __init__(self, functions: Functions, wrt: Sequence[int]) -> None:
        self._step = _virtual_step(functions, wrt)

    def advance(self, problem: Problem, first: int, last: int) -> None:
        """Fill in the samples after `first` up to `last`; from where a run diverges they are NaN."""
        runs, own = len(problem.x), slice(first, last)
        shared = (problem.t[:, first : last + 1], problem.steps[:, own], problem.u[:, own], problem.p)
        every = (np.broadcast_to(a, (runs, *a.shape[1:])) for a in shared)
        for x, s, t, count, u, p in zip(problem.x, problem.s, *every, strict=True):
            ends = np.cumsum(count)
            h = np.repeat(np.diff(t) / count, count)
            at = np.repeat(t[:-1], count) + h * (np.arange(len(h)) - np.repeat(ends - count, count))
            start = np.concatenate([x[first], s[first].ravel(order="F")])[None]
            given = [np.repeat(u, count, axis=0)[:, None], p[None, None], at[:, None, None], h[:, None, None]]
            found = carried(self._step, start, given, len(h))[ends, 0]
            found[np.logical_or.accumulate(~np.isfinite(found[:, : len(x[0])]).all(axis=1))] = np.nan
            x[first + 1 : last + 1] = found[:, : len(x[0])]
            s[first + 1 : last + 1] = found[:, len(x[0]) :].reshape(len(ends), *s.shape[:0:-1]).swapaxes(1, 2)


def _virtual_step(functions: Functions, wrt: Sequence[int]) -> ca.Function:
    """`z = step(z, u, p, t, h)`: the state and, column by column, its derivatives."""
    f, size, rows = functions, functions.x.numel(), functions.acceleration_rows
    chosen = ca.DM(f.p.numel(), len(wrt))
    for column, place in enumerate(wrt):
        if place >= 0:
            chosen[place, column] = 1
    z, t, h = ca.MX.sym("z", size * (1 + len(wrt))), ca.MX.sym("t"), ca.MX.sym("h")
    u, p = ca.MX.sym("u", f.u.numel()), ca.MX.sym("p", f.p.numel())
    model = f.tangents("x", "p") if wrt else f.dynamics

    def rates(parts: Sequence[ca.MX], reach: float) -> list[ca.MX]:
        if not wrt:
            return [model(*parts, u, p, t + reach * h)]
        x_dot, inverse, by_x, by_p = model(parts[0], u, p, t + reach * h)
        slope = by_x @ parts[1] + by_p @ chosen
        solved = inverse @ slope[rows, :]
        return [x_dot, ca.vertcat(slope[: rows.start, :], solved, slope[rows.stop :, :])]

    parts = [z[:size], *([ca.reshape(z[size:], size, len(wrt))] if wrt else [])]
    after = runge_kutta(rates, parts, [h] * len(parts))
    return ca.Function("step", [z, u, p, t, h], [ca.vertcat(*map(ca.vec, after))])


# --- what `import undertow` gives ------------------------------------------------------------------
def _finite_array(name: str, values: ArrayLike) -> Array:
    array = number_array(name, values)
    if not np.isfinite(array).all():
        raise UndertowError(f"{name} holds values that are not finite: fill or drop the missing ones")
    return array


class Model:
    """A vehicle whose equations are ready to run.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    """

    @of_stated_kinds
    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self._functions = Functions(vehicle)
        self._simulator = Simulator(self._functions)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: pose, velocities, then those that effects own."""
        return self._functions.state_names

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the commands."""
        return self.vehicle.command_names

    def simulate(self, x0: ArrayLike, u: ArrayLike, dt: float) -> NDArray[np.float64]:
        """Simulate with inputs that are held between samples (zero-order hold).

        Parameters
        ----------
        x0 : array_like, shape (nx,)
            State at the start, SI, in the order of `states`.
        u : array_like, shape (n, nu)
            Inputs; u[i] holds from i dt to (i + 1) dt.
        dt : float
            Time between samples, s.

        Returns
        -------
        ndarray, shape (n, nx)
            States at the samples, the first of them x0; NaN from where the motion diverges.

        Raises
        ------
        UndertowError
            If a shape does not fit, a value is not finite, or dt is not positive.
        """
        start, inputs = (_finite_array(name, value) for name, value in (("x0", x0), ("u", u)))
        if not (isinstance(dt, Real) and 0 < dt * max(len(inputs), 1) <= SETTINGS.longest_run):
            raise UndertowError(
                f"dt = {dt!r:.60} s cannot be the time between {len(inputs)} samples: give a positive number "
                f"with which they last at most {SETTINGS.longest_run:g} s"
            )
        p = np.array(self._functions.values(), dtype=float)
        return self._simulator.run(start, dt * np.arange(float(len(inputs))), inputs, p)

    def __repr__(self) -> str:
        return (
            f"Model of {self.vehicle.name}: states {', '.join(self.states)}; inputs {', '.join(self.inputs)}"
        )

    def _repr_html_(self) -> str:
        return html(repr(self))


def compile(vehicle: Vehicle) -> Model:
    """Compile the equations of a vehicle, with a C compiler if there is one.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.

    Returns
    -------
    Model
        `states`, `inputs` and `simulate(x0, u, dt)`.

    Raises
    ------
    UndertowError
        If the compiler fails.

    Examples
    --------
    >>> import numpy as np
    >>> import undertow as ut
    >>> model = ut.compile(ut.load_vehicle("mini-auv"))
    >>> x = model.simulate(np.zeros(len(model.states)), np.zeros((11, len(model.inputs))), dt=0.1)
    >>> x.shape == (11, len(model.states))
    True
    """
    return Model(vehicle)
