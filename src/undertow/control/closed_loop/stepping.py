"""What runs of a closed loop need and fill; compiled code or CasADi's virtual machine runs them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from undertow.codegen.compiler import LANES, Compiler, plain_c, pointer
from undertow.codegen.engine import LANES_HEADER, Entries, defines, lanes_for, packed, unpacked
from undertow.codegen.manifest import whole_samples
from undertow.codegen.simulate import runge_kutta
from undertow.codegen.source import c_file, integers, with_entries
from undertow.errors import UndertowError
from undertow.observer.design import Design

from .interconnection import Interconnection

_OF_RUNS = ("p", "r", "k", "x", "s", "command", "commands", "reports")


@dataclass
class LoopProblem:
    """Runs at the sample that they have come to."""

    dt: float  # sampling interval, s
    substeps: int  # Runge-Kutta steps in it
    continuous: bool  # whether the law acts at every stage of a step instead of being sampled
    input_delay: int  # samples from a command to its thrust
    output_delay: np.ndarray  # (ny,): samples from a motion to its report
    # p, r, k: (b, n): parameters, desired pose of the controller, gains
    p: np.ndarray
    r: np.ndarray
    k: np.ndarray
    # x, s: (b, n): states of vehicle and controller; the first ones are given
    x: np.ndarray
    s: np.ndarray
    command: np.ndarray  # (b, nu): the last command
    # commands, reports: (b, ring, n): those of the last samples, one row for each, in a ring
    commands: np.ndarray
    reports: np.ndarray

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return len(self.x)

    def part(self, runs: slice) -> LoopProblem:
        """Some of the runs, in the same memory."""
        return replace(self, **{name: getattr(self, name)[runs] for name in _OF_RUNS})


@dataclass
class Rows:
    """What is recorded of samples, a row for each; what is not wanted has none."""

    # x, y, u, s, tau: (b, rows, n): True state, what the controller was reported, its commands, its states
    # after the sample, and the force that the law asked for
    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    s: np.ndarray
    tau: np.ndarray

    def of(self, run: int) -> Rows:
        """The rows of one run, arrays of shape (rows, n)."""
        return Rows(*(array[run] for array in vars(self).values()))

    def first(self, count: int) -> Rows:
        """The first rows of one run."""
        return Rows(*(array[:count] for array in vars(self).values()))


SIGNALS = ("x", "y", "u", "s", "tau")


@dataclass(frozen=True)
class Block:
    """Samples of one call, and what is recorded of them."""

    # first, samples: the first sample and how many
    first: int
    samples: int
    stride: int = 1  # recorded is every sample that this divides
    noise: np.ndarray | None = None  # (b, samples, ny): what the sensors add
    extra: np.ndarray | None = None  # (samples, nu): forces from outside
    signals: tuple[str, ...] = SIGNALS  # what is recorded

    @property
    def recorded(self) -> range:
        """The samples that are recorded."""
        begin = -(-self.first // self.stride) * self.stride
        return range(begin, self.first + self.samples, self.stride)

    def rows(self, parts: Interconnection, groups: int, *lanes: int) -> Rows:
        """Rows to be filled, of so many runs or groups of runs in lanes."""
        f, control = parts.functions, parts.control
        sizes = (f.x.numel(), len(parts.reported_names), f.u.numel(), *map(control.size1_out, (1, 2)))
        count = len(self.recorded)
        counts = (count if name in self.signals else 0 for name in SIGNALS)
        return Rows(*(np.empty((groups, c, n, *lanes)) for c, n in zip(counts, sizes, strict=True)))


def problem_of(
    parts: Interconnection,
    start: np.ndarray,
    desired: np.ndarray,
    dt: float,
    substeps: int,
    continuous: bool,
    p: np.ndarray | None = None,
    k: np.ndarray | None = None,
) -> LoopProblem:
    """Runs from their first sample on."""
    runs = len(start)
    p = np.tile(parts.parameters, (runs, 1)) if p is None else p
    k = np.tile(parts.gains, (runs, 1)) if k is None else k
    # Samples that commands and each report are late, the same in all runs.
    late, ages = parts.delays(p)
    seconds = np.column_stack([late, ages])
    known = {s: whole_samples(s, dt) for s in np.unique(seconds).tolist()}
    samples = np.vectorize(known.__getitem__, otypes=[np.int64])(seconds)
    other = np.flatnonzero((samples != samples[0]).any(axis=1))
    if other.size:
        raise UndertowError(
            f"run {other[0]} has different dead times from run 0, in samples of {dt:g} s: simulate runs with "
            "equal dead times together"
        )
    delay, delays = int(samples[0, 0]), np.ascontiguousarray(samples[0, 1:])
    return LoopProblem(
        dt,
        substeps,
        continuous,
        delay,
        delays,
        p,
        np.tile(np.asarray(desired, dtype=float), (runs, 1)),
        k,
        parts.at_rest(start, p),
        np.array([parts.first_states(one) for one in start]),
        np.zeros((runs, parts.functions.u.numel())),
        np.zeros((runs, delay + 1, parts.functions.u.numel())),
        np.zeros((runs, int(delays.max(initial=0)) + 1, len(delays))),
    )


_POINTER = ctypes.c_void_p
_PER_RUN = ("p", "r", "k")
_CHANGED = ("x", "s", "command", "commands", "reports")


class _Loop(ctypes.Structure):
    _fields_ = (
        ("dt", ctypes.c_double),
        *((name, ctypes.c_int64) for name in ("substeps", "continuous", "input_delay", "report_ring")),
        ("output_delay", _POINTER),
        *((name, ctypes.c_int64) for name in ("stride", "rows", *(f"{n}_step" for n in _PER_RUN))),
        *((name, _POINTER) for name in (*_PER_RUN, *_CHANGED, "noise", "extra")),
        ("record", _POINTER * len(SIGNALS)),
    )


class CompiledLoop:
    """Model, sensors, controller, allocation, schedule and integrator in a library for each lane count."""

    parallel = True

    def __init__(self, parts: Interconnection, compiler: Compiler) -> None:
        self._parts, self.lanes = parts, compiler.lanes
        self._entries = Entries(lambda lanes: loop_source(parts, lanes), compiler)
        self._entries(1)

    def run(self, problem: LoopProblem, block: Block) -> Rows:
        lanes = lanes_for(problem.runs, self.lanes)
        arrays = {name: packed(getattr(problem, name), lanes) for name in (*_PER_RUN, *_CHANGED)}
        noise = None if block.noise is None else packed(block.noise, lanes)
        groups = len(arrays["x"])
        record = vars(block.rows(self._parts, groups, lanes)).values()
        loop = _Loop(
            *(problem.dt, problem.substeps, problem.continuous, problem.input_delay),
            *(problem.reports.shape[1], _address(problem.output_delay), block.stride, len(block.recorded)),
            *(arrays[name][0].size for name in _PER_RUN),
            *map(_address, [*arrays.values(), noise, block.extra]),
            (_POINTER * len(SIGNALS))(*(_address(array if array.size else None) for array in record)),
        )
        span = map(ctypes.c_int64, (0, groups, block.first, block.samples))
        self._entries(lanes)(ctypes.byref(loop), *span)
        for name in _CHANGED:
            getattr(problem, name)[:] = unpacked(arrays[name], problem.runs)
        return Rows(*(unpacked(array, problem.runs) for array in record))


def _address(array: np.ndarray | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(None) if array is None else pointer(array)


def loop_source(parts: Interconnection, lanes: int = 1) -> tuple[str, str]:
    """C source of closed loops, and what the name of its entry point begins with."""
    form = parts.functions.prepared
    late = parts.observer if parts.observer and parts.observer.past_steps else None
    control = [late.due, late.replayed, parts.present] if late else [parts.control]
    functions = [form.prepare, form.hold, form.held_dynamics, parts.outputs, *control, parts.law]
    sizes = {
        "LANES": lanes,
        "NX": parts.dynamics.size1_in("x"),
        "NU": parts.dynamics.size1_in("u"),
        "NP": parts.dynamics.size1_in("p"),
        "NQ": form.prepare.size1_out("q"),
        "NW": form.hold.size1_out("w"),
        "NS": parts.control.size1_in("s"),
        "NR": parts.control.size1_in("r"),
        "NK": parts.control.size1_in("k"),
        "NY": parts.control.size1_in("y"),
        "NT": parts.control.size1_out("tau"),
    }
    short = {form.hold.name(), parts.outputs.name()}
    model = [
        plain_c(
            f,
            f.name(),
            prefix="INLINE " if f.name() in short else "static SEPARATE ",
            words=LANES,
            shared=("t", "dt"),
        )
        for f in functions
    ]
    model += _late_observer_c(late, parts) if late else []
    loop = c_file("loop.c", "undertow.control.closed_loop")
    text = "\n".join([defines(sizes.items()), LANES_HEADER, *model, loop])
    return with_entries(text, "run")


def _late_observer_c(observer: Design, parts: Interconnection) -> list[str]:
    """C of the controller behind an observer whose reports come late."""
    sizes = {
        "NZ": observer.z_size,
        "STEP": observer.step_size,
        "KEPT": observer.past_steps,
        "SENSORS": len(observer.sensors),
        "KNOWN": observer.process.u.numel(),
        "OWN": parts.present.size1_out("sn"),
    }
    places = [integers("sensor", parts.sensors), integers("lag", observer.lags)]
    return [defines(sizes.items()), *places, c_file("late.c", "undertow.control.closed_loop")]


class VirtualLoop:
    """The samples of loop.c as one CasADi function, which its virtual machine runs."""

    lanes, parallel = 1, False

    def __init__(self, parts: Interconnection) -> None:
        self._parts = parts
        self._made: dict[tuple[float | int, ...], ca.Function] = {}

    def run(self, problem: LoopProblem, block: Block) -> Rows:
        """Commands and reports of the past stand in `problem` from the last sample backwards."""
        rows, begin = block.rows(self._parts, problem.runs), block.first * problem.dt
        rows_recorded = np.array(block.recorded) - block.first
        for i in range(problem.runs):
            states = [getattr(problem, name)[i].T for name in _CHANGED]
            if block.first == 0:  # before the first sample, sensors report what is true at it
                states[-1][:] = np.asarray(self._parts.outputs(states[0], states[2], problem.p[i], begin))
            noise = 0.0 if block.noise is None else block.noise[i].T
            extra = 0.0 if block.extra is None else block.extra.T
            t = begin + problem.dt * np.arange(block.samples)
            given = (noise, extra, t[None], problem.p[i], problem.r[i], problem.k[i])
            found = [np.asarray(v) for v in self._samples(problem, block.samples)(*states, *given)]
            x, s, u, _, _, y, tau = found
            x = np.hstack([states[0][:, None], x[:, :-1]])
            for name, value in zip(SIGNALS, (x, y, u, s, tau), strict=True):
                if name in block.signals:
                    getattr(rows, name)[i] = value.T[rows_recorded]
            for state, value in zip(states, found, strict=False):
                state[:] = value[:, -1] if state.ndim == 1 else value[:, -state.shape[1] :]
        return rows

    def _samples(self, problem: LoopProblem, count: int) -> ca.Function:
        """Some samples one after the other."""
        late = problem.input_delay, *problem.output_delay.tolist()
        key = (problem.dt, problem.substeps, problem.continuous, *late, count)
        if key not in self._made:
            one = sample_of(self._parts, problem.dt, problem.substeps, problem.continuous, late)
            carried = list(range(len(_CHANGED)))
            self._made[key] = one.mapaccum("samples", count, carried, carried)
        return self._made[key]


def sample_of(
    parts: Interconnection, dt: float, substeps: int = 1, continuous: bool = False, late: Sequence[int] = ()
) -> ca.Function:
    """One sample of the controller and the motion up to the next, as loop.c has it.

    `(x, s, u, commands, reports, y, tau) = sample(x, s, u, commands, reports, noise, extra, t, p, r, k)`; u
    is the last command, `commands` and `reports` have a column for each sample, the last one first; `late`
    says how many samples the commands and each report are late, none by default.
    """
    f, control = parts.functions, parts.control
    delay, *delays = late or [0] * (1 + len(parts.reported_names))
    sizes = {"x": f.x.numel(), "s": control.size1_in("s"), "u": f.u.numel()}
    x, s, u = start = [ca.MX.sym(n, size) for n, size in sizes.items()]
    commands = ca.MX.sym("commands", sizes["u"], delay + 1)
    reports = ca.MX.sym("reports", len(delays), max(delays, default=0) + 1)
    noise, extra, t = ca.MX.sym("noise", len(delays)), ca.MX.sym("extra", sizes["u"]), ca.MX.sym("t")
    p, r, k = ca.MX.sym("p", f.p.numel()), *(ca.MX.sym(n, control.size1_in(n)) for n in "rk")
    seen = ca.horzcat(parts.outputs(x, u, p, t), reports[:, :-1])
    y = ca.vertcat(*[seen[i, age] for i, age in enumerate(delays)]) + noise
    u, s, tau = control(y, r, s, k, 0.0 if continuous else dt)
    sent = ca.horzcat(u, commands[:, :-1])
    for i in range(substeps):
        h = dt / substeps
        if continuous:
            x, s = _with_law(parts, [x, s], (extra, t + i * h, h, p, r, k))
        else:
            held, now = sent[:, -1] + extra, t + i * h
            (x,) = runge_kutta(lambda z, reach: [parts.dynamics(*z, held, p, now + reach * h)], [x], [h])  # noqa: B023
    inputs = [*start, commands, reports, noise, extra, t, p, r, k]
    return ca.Function("sample", inputs, [x, s, u, sent, seen, y, tau])


def _with_law(parts: Interconnection, state: Sequence[ca.MX], given: tuple[ca.MX, ...]) -> list[ca.MX]:
    """A step of vehicle and law together, the law at every stage."""
    extra, t, h, p, r, k = given
    u = ca.MX.zeros(extra.shape)

    def rates(z: Sequence[ca.MX], reach: float) -> list[ca.MX]:
        nonlocal u
        now = t + reach * h
        commands, s_dot, _ = parts.law(parts.outputs(z[0], u, p, now), r, z[1], k)
        u = commands + extra
        return [parts.dynamics(z[0], u, p, now), s_dot]

    return runge_kutta(rates, state, [h, h])


LoopStepper = CompiledLoop | VirtualLoop
