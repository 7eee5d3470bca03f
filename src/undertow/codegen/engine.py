"""Execution: instructions as data over samples, and trajectories in C, side by side in lanes and threads."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from threading import Lock
from typing import Any, Protocol, TypeVar

import casadi as ca
import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Integers

from .compiler import LANES, Bound, Compiler, compiled_or_virtual, library_for, loaded, plain_c, pointer
from .functions import Functions, solve_symmetric
from .source import INSTRUCTIONS, c_file, engine_file, engine_source, integers, with_entries

_NUMBER = {code: INSTRUCTIONS[name] for name, code in vars(ca).items() if name in INSTRUCTIONS}


@dataclass(frozen=True)
class EngineSettings:
    """Settings of loops over samples and runs."""

    # Samples that are computed together where code is not compiled: making a map of CasADi's costs time in
    # proportion to them, and it serves any number. Rows of as many are in memory together.
    chunk: int = 128
    few: int = 2  # so few runs are as fast one after the other as side by side
    # Steps in the share of a thread: from a millisecond, which is worth a thread of its own, to the tenth of
    # a second that Ctrl-C may wait.
    steps_in_share: tuple[int, int] = (20_000, 1_000_000)
    shares: int = 4  # for each thread, so that none waits long for the others
    side_by_side: int = 8  # windows that are simulated in one share at least


SETTINGS = EngineSettings()


class TapeData(ctypes.Structure):
    """A tape as tape.c takes it."""

    _fields_ = (
        ("length", ctypes.c_int64),
        ("slots", ctypes.c_int64),
        ("code", ctypes.c_void_p),
        ("constants", ctypes.c_void_p),
    )


class Tape:
    """The instructions of a CasADi function of scalars, ready to run.

    Compiled code is given `data`, which points into this object: that has to live as long.
    """

    def __init__(self, function: ca.Function) -> None:
        count = function.n_instructions()
        self._code = np.zeros((count, 4), dtype=np.int32)
        self._constants = np.zeros(count)
        for k in range(count):
            operation = function.instruction_id(k)
            if operation not in _NUMBER:
                raise UndertowError(
                    f"operation {operation} of a model has no counterpart in C: restate the effect"
                )
            self._set(k, operation, function.instruction_output(k), function.instruction_input(k))
            if operation == ca.OP_CONST:
                self._constants[k] = function.instruction_constant(k)
        self.slots = function.sz_w() + 1
        self.data = TapeData(count, self.slots, self._code.ctypes.data, self._constants.ctypes.data)

    def _set(self, k: int, operation: int, into: list[int], operands: list[int]) -> None:
        if operation == ca.OP_OUTPUT:  # from a register to an entry of an output
            self._code[k] = _NUMBER[operation], into[0], operands[0], into[1]
        else:
            self._code[k, :2] = _NUMBER[operation], into[0]
            self._code[k, 2 : 2 + len(operands)] = operands


# --- the library ----------------------------------------------------------------------------------
class Engine:
    """Entry points of the library that runs tapes."""

    def __init__(self, library: ctypes.CDLL, prefix: str) -> None:
        self.at_samples = entry_point(library, f"{prefix}at_samples", ctypes.c_int)
        self.carry = entry_point(library, f"{prefix}carry", ctypes.c_int)
        self.simulate = entry_point(library, f"{prefix}simulate")


def entry_point(library: ctypes.CDLL, name: str, result: Any = ctypes.c_int64) -> Callable[..., Any]:
    """A function of a library that returns this type."""
    entry: Callable[..., Any] = getattr(library, name)
    entry.restype = result  # type: ignore[attr-defined]
    return entry


def engine() -> Engine | None:
    """The engine, compiled once for all models, or that of the wheel; None where there is neither."""
    return compiled_or_virtual(None, lambda compiler: _compiled(compiler.for_this_machine()), _prebuilt)


@cache
def _compiled(compiler: Compiler) -> Engine:
    source, prefix = engine_source()
    return Engine(loaded(library_for(source, compiler)), prefix)


@cache
def _prebuilt() -> Engine | None:
    """The engine that the wheel brings along, if that is of this version and for this machine."""
    if not engine_file().is_file():
        return None
    try:
        return Engine(loaded(engine_file()), engine_source()[1])
    except (UndertowError, AttributeError):
        return None


# --- a function at many samples -------------------------------------------------------------------
class Blockwise:
    """A CasADi function of scalars, run over blocks of samples: several times as fast as sample by sample."""

    def __init__(self, function: ca.Function, run: Engine) -> None:
        self._engine, self._tape = run, Tape(function)
        self._outputs = [function.nnz_out(i) for i in range(function.n_out())]

    def __call__(self, arguments: Sequence[Array], count: int) -> list[Array]:
        """Structural nonzeros of the outputs at `count` samples, each of shape (count, nnz)."""
        inputs = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        assert all(a.ndim == 1 or len(a) == count for a in inputs)
        results = [np.zeros((count, size)) for size in self._outputs]
        strides = [a.shape[1] if a.ndim > 1 else 0 for a in inputs]
        failed = self._engine.at_samples(
            ctypes.c_int64(count),
            ctypes.byref(self._tape.data),
            *_table(inputs, strides),
            *_table(results, self._outputs),
        )
        self._check(failed)
        return results

    def carry(self, state: Array, arguments: Sequence[Array]) -> None:
        """Fill in a state (steps + 1, chains, n) from its first row; arguments are (steps, chains, k)."""
        whole = ((a, a.shape[2] < 2 or a.strides[2] == a.itemsize) for a in (state[:-1], *arguments))
        inputs = [a if together else a.copy() for a, together in whole]
        strides = [[a.strides[axis] // a.itemsize for a in inputs] for axis in (1, 0)]
        failed = self._engine.carry(
            *map(ctypes.c_int64, arguments[0].shape[:2]),
            ctypes.byref(self._tape.data),
            ctypes.c_int64(len(inputs)),
            *_table(inputs, strides[0]),
            (ctypes.c_int64 * len(inputs))(*strides[1]),
            pointer(state),
            ctypes.c_int64(state.shape[2]),
        )
        self._check(failed)

    def _check(self, failed: int) -> None:
        if failed:
            raise UndertowError(
                f"no memory for {self._tape.slots} registers of a block of samples: close other programs"
            )


def _table(arrays: Sequence[Array], strides: Sequence[int]) -> tuple[ctypes.Array, ctypes.Array]:
    """Addresses of arrays, and the distances from sample to sample in them."""
    addresses = (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))
    return addresses, (ctypes.c_int64 * len(strides))(*strides)


@lru_cache(maxsize=256)
def blockwise(function: ca.Function) -> Blockwise | None:
    """The function block by block; None where there is no engine, or where it is no function of scalars."""
    if not function.is_a("SXFunction"):
        return None
    run = engine()
    return None if run is None else Blockwise(function, run)


def at_samples(function: ca.Function, arguments: Sequence[Array], count: int) -> list[Array]:
    """Structural nonzeros of the outputs of a function at `count` samples, each of shape (count, nnz).

    Arguments are (count, k) where they differ from sample to sample, (k,) where they are the same for all.
    """
    run = blockwise(function)
    return _in_chunks(function, arguments, count) if run is None else run(arguments, count)


def carried(function: ca.Function, start: Array, arguments: Sequence[Array], steps: int) -> Array:
    """All states of `state = function(state, *arguments)` from a start (chains, n), (steps + 1, chains, n).

    Arguments are as (steps, chains, k), where they are not the same in all steps or chains.
    """
    state = np.empty((steps + 1, *start.shape))
    state[0] = start
    every = [np.broadcast_to(np.asarray(a, dtype=float), (steps, len(start), a.shape[-1])) for a in arguments]
    run = blockwise(function)
    if run is not None:
        run.carry(state, every)
        return state
    for i, begin in enumerate(start if steps else ()):
        (flat,) = call(_accumulated(function, steps), [begin, *(a[:, i] for a in every)])
        state[1:, i] = flat.reshape(steps, -1)
    return state


@lru_cache(maxsize=64)
def _accumulated(function: ca.Function, steps: int) -> ca.Function:
    return function.mapaccum("accumulated", steps)


def mapped(function: ca.Function, columns: Sequence[Array], p: Array, t: Array) -> list[Array]:
    """Values at N samples of `function(*columns, p, t)`, each (N, rows, columns); `columns` are (N, k).

    The function's outputs have to be dense.
    """
    flat = at_samples(function, [*columns, p, t[:, None]], len(t))
    shapes = [function.size_out(i) for i in range(function.n_out())]
    # CasADi is column-major: a sample's matrix lies transposed in the flat result.
    return [f.reshape(len(t), c, r).transpose(0, 2, 1) for f, (r, c) in zip(flat, shapes, strict=True)]


# --- by the virtual machine -----------------------------------------------------------------------
def _in_chunks(function: ca.Function, arguments: Sequence[Array], count: int) -> list[Array]:
    """What `at_samples` gives."""
    bound = Bound(function, SETTINGS.chunk)
    results = [np.zeros((count, a.shape[1])) for a in bound.outputs]
    for first in range(0, count, SETTINGS.chunk):
        here = min(SETTINGS.chunk, count - first)
        for array, given in zip(bound.inputs, arguments, strict=True):
            array[:here] = given[first : first + here] if given.ndim > 1 else given
        bound.run()
        for result, array in zip(results, bound.outputs, strict=True):
            result[first : first + here] = array[:here]
    return results


def call(function: ca.Function, arguments: Sequence[Array]) -> list[Array]:
    """Call a function once; arguments and results are flat, column-major, dense."""
    bound = Bound(function)
    for array, given in zip(bound.inputs, arguments, strict=True):
        array[0] = np.ravel(given)
    bound.run()
    return [array[0] for array in bound.outputs]


# --- trajectories in C: runs side by side; sensitivities, or sums of them -------------------------
@dataclass
class Problem:
    """Arrays of a simulation; where runs share t, u or p, its leading size is one."""

    t: Array  # (b or 1, n): times of the samples, s
    steps: Integers  # (b or 1, n - 1): Runge-Kutta steps from sample to sample
    u: Array  # (b or 1, n, nu): inputs, held from their sample to the next
    p: Array  # (b or 1, np): parameters
    x: Array  # (b, n, nx): states; the first sample is given, the others are written
    wrt: Integers  # (m,): parameter of every sensitivity column, -1 for columns of an initial state
    # (b, n, nx, m): sensitivities; the first sample is given, the others are written. No column where none
    # are wanted; of the first sample alone, (b, 1, nx, m), where only sums of products are.
    s: Array

    def part(self, runs: slice) -> Problem:
        """Some of the runs, in the same memory."""
        names = ("t", "steps", "u", "p", "x", "s")
        arrays = {n: getattr(self, n) for n in names}
        own = len(self.x)
        return replace(self, **{n: a[runs] if len(a) == own else a for n, a in arrays.items()})


class Stepper(Protocol):
    """Advances a problem from sample `first` to sample `last`."""

    def advance(self, problem: Problem, first: int, last: int) -> None: ...


T = TypeVar("T")
LANES_HEADER = c_file("lanes.h")
_LIMIT = "UNDERTOW_JOBS"


def lanes_for(runs: int, lanes: int) -> int:
    """How many lanes a number of runs goes through."""
    return 1 if runs <= SETTINGS.few else lanes


def packed(array: Array, lanes: int) -> Array:
    """Runs side by side: shape (b, ...) to (groups, ..., lanes); the last run fills up the last group.

    With one lane the memory is the same.
    """
    if lanes == 1:
        return np.ascontiguousarray(array)[..., None]
    groups = -(-len(array) // lanes)
    lacking = groups * lanes - len(array)
    full = np.concatenate([array, np.repeat(array[-1:], lacking, axis=0)]) if lacking else array
    return np.ascontiguousarray(np.moveaxis(full.reshape(groups, lanes, *array.shape[1:]), 1, -1))


def unpacked(array: Array, runs: int) -> Array:
    """The reverse of `packed`, a view where there is one lane."""
    if array.shape[-1] == 1:
        return array[..., 0]
    groups, lanes = len(array), array.shape[-1]
    return np.moveaxis(array, -1, 1).reshape(groups * lanes, *array.shape[1:-1])[:runs]


def processors() -> int:
    """How many processors this process may use, or as many as UNDERTOW_JOBS says."""
    stated = os.environ.get(_LIMIT, "")
    if stated.isdecimal():
        return max(1, int(stated))
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def in_threads(
    work: Callable[[T], object],
    parts: Sequence[T],
    threads: int | None,
    done: Callable[[T], object] = lambda part: None,
) -> None:
    """Do the parts of a work in threads; compiled code runs outside Python's lock.

    By default as many threads as there are processors. `done` is called with every part that is done, in the
    thread of the caller.
    """
    wanted = processors() if threads is None else threads
    if wanted < 1:
        raise UndertowError(f"threads = {threads}: give one at least")
    if min(wanted, len(parts)) == 1:
        for part in parts:
            work(part)
            done(part)
        return
    with ThreadPoolExecutor(min(wanted, len(parts))) as pool:
        started = {pool.submit(work, part): part for part in parts}
        try:
            for future in as_completed(started):
                future.result()
                done(started[future])
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def shares(runs: int, work: float, threads: int | None, lanes: int) -> list[slice]:
    """Runs in shares of whole groups, each a fraction of a second and a few for every thread."""
    groups, wanted = -(-runs // lanes), threads or processors()
    least, most = (max(int(steps / max(work, 1) / lanes), 1) for steps in SETTINGS.steps_in_share)
    each = lanes * min(max(-(-groups // (SETTINGS.shares * wanted)), least), most)
    return [slice(a, min(a + each, runs)) for a in range(0, runs, each)]


def defines(sizes: Iterable[tuple[str, int]]) -> str:
    """Sizes as C macros; C has no empty arrays."""
    return "".join(f"#define {name} {max(size, 1)}\n" for name, size in sizes)


_GROUP_ARRAYS = ("t", "count", "u", "p")


class _RolloutLogs(ctypes.Structure):
    _fields_ = (
        ("samples", ctypes.c_int64),
        *((f"{name}_step", ctypes.c_int64) for name in _GROUP_ARRAYS),
        *((name, ctypes.c_void_p) for name in (*_GROUP_ARRAYS, "x")),
    )


class Entries:
    """Entry points of a loop for different numbers of lanes, each compiled when it is first asked for."""

    def __init__(self, source: Callable[[int], tuple[str, str]], compiler: Compiler) -> None:
        # What is a vector is so already; others that the compiler makes up cost a twentieth.
        self._source, self._compiler = source, compiler.for_this_machine("-fno-tree-vectorize")
        self._known: dict[int, Callable[..., Any]] = {}
        self._building = Lock()

    def __call__(self, lanes: int) -> Callable[..., Any]:
        """The entry point for so many lanes."""
        with self._building:
            if lanes not in self._known:
                source, prefix = self._source(lanes)
                library = loaded(library_for(source, self._compiler))
                self._known[lanes] = entry_point(library, f"{prefix}run", None)
        return self._known[lanes]


class CompiledRollout:
    """Runge-Kutta around the generated dynamics: one call for many samples of many runs."""

    def __init__(self, functions: Functions, compiler: Compiler) -> None:
        self.lanes = compiler.lanes
        self._entries = Entries(lambda lanes: rollout_source(functions, lanes), compiler)
        self._entries(1)

    def advance(self, problem: Problem, first: int, last: int) -> None:
        lanes, runs = lanes_for(len(problem.x), self.lanes), len(problem.x)
        arrays = {
            "t": packed(problem.t[:, first : last + 1], lanes),
            "count": packed(problem.steps[:, first:last].astype(float), lanes),
            "u": packed(problem.u[:, first:last], lanes),
            "p": packed(problem.p, lanes),
        }
        x = packed(problem.x[:, first : last + 1], lanes)
        steps = (0 if len(a) < len(x) else a[0].size for a in arrays.values())
        logs = _RolloutLogs(last + 1 - first, *steps, *map(_address, [*arrays.values(), x]))
        self._entries(lanes)(ctypes.byref(logs), ctypes.c_int64(len(x)))
        problem.x[:, first + 1 : last + 1] = unpacked(x, runs)[:, 1:]


def _address(array: Array) -> ctypes.c_void_p:
    assert array.dtype == np.float64
    return pointer(array)


def rollout_source(functions: Functions, lanes: int) -> tuple[str, str]:
    """C source of a simulation, and what the name of its entry point begins with."""
    model = model_source(functions)
    text = "\n".join([defines([("LANES", lanes)]), LANES_HEADER, model, c_file("rollout.c")])
    return with_entries(text, "run")


def model_source(functions: Functions) -> str:
    """C source of the prepared form, for any number of lanes, with its sizes."""
    form = functions.prepared
    sizes = {
        "NX": functions.x.numel(),
        "NU": functions.u.numel(),
        "NP": functions.p.numel(),
        "NQ": form.prepare.size1_out("q"),
        "NW": form.hold.size1_out("w"),
    }
    steps = form.prepare, form.hold, form.held_dynamics
    model = [plain_c(f, f.name(), prefix="static SEPARATE ", words=LANES) for f in steps]
    return "\n".join([defines(sizes.items()), *model])


@dataclass(frozen=True)
class Products:
    """Sums of products of weighted errors and their derivatives, by window and group of samples."""

    # products of the m derivatives (parameters, then initial values of pose and velocity) and, as the last
    # row and column, the error
    table: Array
    squares: Array  # sum of squares of the weighted errors by channel
    diverged: bool  # whether a simulation left the finite numbers; the sums then mean nothing


def products_of(value: Array, slope: Array, measured: Array, weight: Array, group: Integers) -> Products:
    """The same sums from what was simulated.

    `value` is pose and velocity, or what the sensors report of them, shape (b, n, 2 dof); `slope` its
    derivatives, shape (b, n, 2 dof, m); the others as for `Simulator.products`.
    """
    b, _, channels, m = slope.shape
    rows, columns = np.nonzero((weight != 0).any(axis=0))
    weights, groups = weight[:, rows, columns], group[:, rows]
    both = np.empty((b, len(rows), m + 1))
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverges is reported as such
        np.multiply(slope[:, rows, columns], weights[..., None], out=both[..., :m])
        np.multiply((value - measured)[:, rows, columns], weights, out=both[..., m])
        if np.any(unused := weights == 0):
            both[unused] = 0.0
        errors = both[..., m] ** 2
        squares = np.stack([errors[:, columns == c].sum(axis=1) for c in range(channels)], axis=1)
    found = Products(np.zeros((b, int(group.max(initial=0)) + 1, m + 1, m + 1)), squares, diverged=False)
    if not (np.isfinite(value).all() and np.isfinite(squares).all() and np.isfinite(both).all()):
        return replace(found, diverged=True)
    for g in range(found.table.shape[1]):
        inside = groups == g
        there = np.flatnonzero(inside.any(axis=0))
        if not there.size:
            continue
        span = slice(there[0], there[-1] + 1)
        part = both[:, span]
        if not inside[:, span].all():
            part = np.where(inside[:, span, None], part, 0.0)
        with np.errstate(over="ignore", invalid="ignore"):
            found.table[:, g] = np.swapaxes(part, 1, 2) @ part
    return replace(found, diverged=not np.isfinite(found.table).all())


# --- calls of tangents.c --------------------------------------------------------------------------
_RUN_ARRAYS = ("t", "u", "p", "steps")


class _TangentLogs(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("samples", "first", "last")),
        *((f"{name}_stride", ctypes.c_int64) for name in (*_RUN_ARRAYS, "x")),
        *((name, ctypes.c_void_p) for name in (*_RUN_ARRAYS, "x", "s")),
        ("groups", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("measured", "weight", "group", "table", "squares")),
    )


class Tangents:
    """Simulation of a model with sensitivities."""

    def __init__(self, run: Callable[..., int], model: _Model | None = None) -> None:
        self._run, self._model = run, model

    def advance(self, problem: Problem, first: int, last: int) -> None:
        """Record states and sensitivities from sample `first` to sample `last`."""
        self._call_library(problem, (first, last), problem.x, problem.s)

    def products(self, problem: Problem, measured: Array, weight: Array, group: Integers) -> Products:
        """Sums over the samples of every window; `group` says of which sum of its window a sample is part.

        Derivatives in the initial pose and velocity follow those in parameters.
        """
        b, _, channels = measured.shape
        width, groups = problem.wrt.size + 1, int(group.max(initial=0)) + 1
        found = Products(np.zeros((b, groups, width, width)), np.zeros((b, channels)), diverged=False)
        start = problem.x[:, 0].copy()
        arrays: Sequence[np.ndarray] = (measured, weight, group, found.table, found.squares)
        diverged: list[int] = []

        def work(rows: slice) -> None:
            part = problem.part(rows)
            span = 0, part.t.shape[1] - 1
            diverged.append(
                self._call_library(part, span, start[rows], part.s, groups, *(a[rows] for a in arrays))
            )

        # Every derivative is carried along like a state.
        steps = float(problem.steps.sum(axis=1).max(initial=1)) * problem.wrt.size
        in_threads(work, shares(b, steps, None, SETTINGS.side_by_side), None)
        if any(diverged) or not np.isfinite(found.table).all():
            return Products(found.table, found.squares, diverged=True)
        lower = np.tril_indices(width, -1)
        found.table[:, :, lower[0], lower[1]] = found.table[:, :, lower[1], lower[0]]
        return found

    def _call_library(
        self,
        problem: Problem,
        span: tuple[int, int],
        x: Array,
        s: Array,
        groups: int = 0,
        *sums: np.ndarray,
    ) -> int:
        shared: list[np.ndarray] = [getattr(problem, name) for name in _RUN_ARRAYS]
        logs = _TangentLogs(
            *(problem.t.shape[1], *span),
            *(0 if len(a) == 1 else a.strides[0] // a.itemsize for a in shared),
            *(x.strides[0] // x.itemsize, *map(pointer, shared), pointer(x)),
            *(pointer(s), groups, *map(pointer, sums)),
        )
        model = () if self._model is None else (ctypes.byref(self._model),)
        diverged = int(self._run(*model, ctypes.byref(logs), ctypes.c_int64(len(x))))
        if diverged < 0:
            raise UndertowError(f"no memory for {problem.wrt.size} sensitivities: ask for fewer at a time")
        return diverged


# --- a model that is data -------------------------------------------------------------------------
_PATTERNS = tuple(f"{of}_{what}" for of in ("rx", "rp") for what in ("start", "column", "place"))


class _Model(ctypes.Structure):
    """A model as tangents.c takes it, where it is not compiled."""

    _fields_ = (
        ("tape", TapeData),
        *((name, ctypes.c_int64) for name in ("nx", "nu", "nd", "nf", "columns")),
        *((name, ctypes.c_void_p) for name in _PATTERNS),
        *((name, ctypes.c_int64) for name in ("rx_nonzeros", "rp_nonzeros")),
    )


class InterpretedModel:
    """The instructions of a model, run at once by the engine: compiling takes longer than a run or two."""

    def __init__(self, functions: Functions, run: Engine, *, sensitivities: bool) -> None:
        self._run = run.simulate
        self._function = functions.tangents("x", "p") if sensitivities else functions.dynamics
        self._tape = Tape(self._function)
        degrees = functions.nu_dot.numel() if sensitivities else 0
        self._sizes = functions.x.numel(), functions.u.numel(), degrees
        self._slopes = [self._function.sparsity_out(n) for n in ("R_x", "R_p") if sensitivities]

    def tangents(self, wrt: Sequence[int]) -> Tangents:
        """The simulation with derivatives in these parameters, and for each -1 in an initial state."""
        chosen = [k for k in wrt if k >= 0]
        rows = [_by_rows(s, c) for s, c in zip(self._slopes, (None, chosen), strict=False)]
        tables = [np.array(part, dtype=np.int32) for row in rows or [([0],) * 3] * 2 for part in row]
        nonzeros = [s.nnz() for s in self._slopes] or [0, 0]
        addresses = [a.ctypes.data for a in tables]
        model = _Model(self._tape.data, *self._sizes, len(chosen), len(wrt), *addresses, *nonzeros)
        model.kept = self._tape, tables  # it points into these
        return Tangents(self._run, model)


# --- a model that is compiled ---------------------------------------------------------------------
def compiled_tangents(functions: Functions, wrt: Sequence[int], compiler: Compiler) -> Tangents:
    """The simulation compiled for these parameters to differentiate by, with -1 for each initial state."""
    source, prefix = tangents_source(functions, wrt)
    library = loaded(library_for(source, compiler.for_this_machine()))
    return Tangents(entry_point(library, f"{prefix}simulate"))


def tangents_source(functions: Functions, wrt: Sequence[int]) -> tuple[str, str]:
    """C source of the simulation, and what the name of its entry point begins with."""
    places = [k for k in wrt if k >= 0]
    inverse, slopes, steady = _parts(functions, places)
    sizes = {
        "NX": functions.x.numel(),
        "NU": functions.u.numel(),
        "ND": functions.nu_dot.numel(),
        "NF": len(places),
        "COLUMNS": len(wrt),
    }
    lines = [f"#define {k} {v}" for k, v in sizes.items()]
    lines += ["#define STEADY"] if steady else []
    for name, output in (("RX", "R_x"), ("RP", "R_p")):
        pattern = slopes.sparsity_out(output)
        lines.append(f"#define {name}_NONZEROS {pattern.nnz()}")
        tables = zip(("START", "COLUMN", "PLACE"), _by_rows(pattern), strict=True)
        lines += [integers(f"{name}_{what}", values) for what, values in tables]
    prefix = "static SEPARATE "
    model = plain_c(inverse, "inverse", prefix=prefix)
    model += plain_c(slopes, "slopes", packed=("R_x", "R_p"), prefix=prefix)
    text = "\n".join([*lines, c_file("portable.h"), model, c_file("tangents.c")])
    return with_entries(text, "simulate")


def _parts(functions: Functions, places: Sequence[int]) -> tuple[ca.Function, ca.Function, bool]:
    """W(x, u, p, t); (x_dot, R_x, R_p) from x, u, p, t, W as for `Functions.tangents`; is W of p alone?"""
    f = functions
    size = f.nu_dot.numel()
    W = ca.SX.sym("W", size, size)
    inputs, names = [f.x, f.u, f.p, f.t], ["x", "u", "p", "t"]
    mass = f.mass_matrix
    inverse = ca.densify(ca.cse(solve_symmetric(mass, ca.SX.eye(size))))
    rows = f.acceleration_rows
    at_rest = ca.substitute(f.balance, f.nu_dot, ca.SX.zeros(size))
    acceleration = W @ at_rest[rows]
    x_dot = ca.vertcat(at_rest[: rows.start], acceleration, at_rest[rows.stop :])
    slopes = [ca.jacobian(f.balance, f.x), ca.jacobian(f.balance, f.p)[:, list(places)]]
    outputs = [ca.densify(x_dot), *(ca.substitute(s, f.nu_dot, acceleration) for s in slopes)]
    steady = not ca.depends_on(mass, ca.vertcat(f.x, f.u, f.t))
    return (
        ca.Function("inverse", inputs, [inverse], names, ["W"]),
        ca.Function("slopes", [*inputs, W], ca.cse(outputs), [*names, "W"], ["x_dot", "R_x", "R_p"]),
        steady,
    )


def _by_rows(sparsity: ca.Sparsity, chosen: Sequence[int] | None = None) -> tuple[list[int], ...]:
    """Nonzeros row by row: first of each row, columns, and where each stands in an output stored by columns.

    Of the `chosen` columns in this order, by default of all.
    """
    columns = range(sparsity.size2()) if chosen is None else chosen
    starts, rows = sparsity.get_ccs()
    entries = sorted((rows[k], c, k) for c, j in enumerate(columns) for k in range(starts[j], starts[j + 1]))
    first = [sum(row < i for row, _, _ in entries) for i in range(sparsity.size1() + 1)]
    return first, [c for _, c, _ in entries], [k for _, _, k in entries]
