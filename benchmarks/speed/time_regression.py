"""Least squares on a million samples: six rows each, thirty parameters, the same data for everybody.

Everybody gets columns of states, accelerations and commands, and has to come to the parameters; distances are
in units of the regressor's columns. PySINDy does a piece of the work, and its time is scaled.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from threading import Thread

import casadi as ca
import numpy as np
import pytest

from undertow.codegen.gram import layout
from undertow.codegen.source import FORMS
from undertow.identification.estimation.fitted import TriangularFactor
from undertow.paper.regression import LinearFit

from . import vehicle
from .conftest import Speed
from .goals import OURS, REGRESSION

NAMES = (
    *("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot", "X_qdot", "Y_pdot", "Y_rdot", "Z_qdot"),
    *("X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r", "Y_r", "N_v", "Z_q", "M_w"),
    *("X_uabsu", "Y_vabsv", "Z_wabsw", "K_pabsp", "M_qabsq", "N_rabsr", "W", "S_x", "S_y", "S_z"),
)
SAMPLES, PIECE, LIMIT = 1_000_000, 50_000, 1e-8
GROWTH = "regression, by samples"
# As many samples as NumPy builds the rows of fastest.
_AT_A_TIME = 5_000
_ODD: dict[str, Callable[..., np.ndarray]] = {
    **{"OP_SIN": np.sin, "OP_COS": np.cos, "OP_FABS": np.abs, "OP_SQ": np.square},
    **{"OP_ADD": np.add, "OP_SUB": np.subtract, "OP_MUL": np.multiply, "OP_DIV": np.divide},
    **{"OP_NEG": np.negative, "OP_TWICE": lambda a: 2 * a, "OP_INV": lambda a: 1 / a},
}


@cache
def fit() -> LinearFit:
    """Ours, ready."""
    return LinearFit(vehicle.functions(), NAMES, compiled=True)


def solved(logs: list[dict[str, np.ndarray]]) -> np.ndarray:
    """Our estimates from all samples of some logs."""
    triangle = TriangularFactor(len(NAMES))
    for log in logs:
        triangle.add(*fit().triangle(log))
    H, target = triangle.split()
    length = np.linalg.norm(H, axis=0)
    return np.linalg.lstsq(H / length, target, rcond=None)[0] / length


@cache
def samples() -> dict[str, np.ndarray]:
    """Columns that the rows need: random motion and commands, accelerations of the model with noise."""
    f, rng = vehicle.functions(), np.random.default_rng(3)
    x = rng.uniform(-0.5, 0.5, (len(f.state_names), SAMPLES))
    u = rng.uniform(-10, 10, (f.u.numel(), SAMPLES))
    dynamics, p = f.dynamics.map(1000), np.array(f.values())
    pieces = (slice(i, i + 1000) for i in range(0, SAMPLES, 1000))
    parts = [np.array(dynamics(x[:, piece], u[:, piece], p, 0.0)) for piece in pieces]
    rates = np.concatenate(parts, axis=1)[6:12] + 0.1 * rng.standard_normal((6, SAMPLES))
    names = (*f.state_names, *(f"{n}_dot" for n in f.vehicle.velocity_names), *f.vehicle.command_names)
    columns = dict(zip(names, np.vstack([x, rates, u]), strict=True))
    return {name: np.ascontiguousarray(columns[name]) for name in fit().used_inputs}


def some(count: int) -> dict[str, np.ndarray]:
    """The first samples."""
    return {name: column[:count] for name, column in samples().items()}


# --- peers --------------------------------------------------------------------------------------


class ByNumPy:
    """The regressor as somebody would write it with NumPy: expressions of whole columns, none twice."""

    def __init__(self) -> None:
        f = vehicle.functions()
        self.known = layout(f, [f.parameter_names.index(n) for n in NAMES])
        self._function = self.known.function
        names = {v: k for k, v in vars(ca).items() if k.startswith("OP_")}
        self._steps = [
            (
                names[self._function.instruction_id(k)],
                self._function.instruction_output(k),
                self._function.instruction_input(k),
                self._function.instruction_constant(k)
                if names[self._function.instruction_id(k)] == "OP_CONST"
                else 0.0,
            )
            for k in range(self._function.n_instructions())
        ]

    def rows(self, columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Regressor (6 n, 30) and target."""
        flat = np.empty((6 * len(next(iter(columns.values()))), len(NAMES) + 1))
        self.fill(flat, columns)
        return flat[:, :-1], flat[:, -1]

    def fill(self, flat: np.ndarray, columns: dict[str, np.ndarray]) -> None:
        """Write regressor and target, (6 n, 31)."""
        count, known = len(next(iter(columns.values()))), self.known
        given = dict(zip(known.used_inputs, columns.values(), strict=True))
        p, offset = vehicle.functions().values(), np.cumsum([0, 12, 6, 8])
        table = flat.reshape(count, known.degrees, len(NAMES) + 1)
        table[:] = 0.0
        value: dict[int, np.ndarray | float] = {}
        for operation, into, operands, constant in self._steps:
            if operation == "OP_INPUT":
                group, k = operands
                place = {3: -1}.get(group, offset[min(group, 3)] + k)
                value[into[0]] = p[k] if place < 0 else given.get(int(place), 0.0)
            elif operation == "OP_OUTPUT":
                table[:, known.row[into[1]], known.column[into[1]]] = value[operands[0]]
            elif operation == "OP_CONST":
                value[into[0]] = constant
            else:
                binary = "{1}" in FORMS[operation]
                value[into[0]] = _ODD[operation](*(value[i] for i in operands[: 1 + binary]))


@cache
def numpy_rows() -> ByNumPy:
    """The peer's regressor."""
    return ByNumPy()


def by_numpy(count: int = SAMPLES) -> np.ndarray:
    """Build all rows, some thousand samples at a time, then lstsq."""
    columns, table = some(count), np.empty((6 * count, len(NAMES) + 1))
    for i in range(0, count, _AT_A_TIME):
        rows = slice(i, min(i + _AT_A_TIME, count))
        numpy_rows().fill(table[6 * rows.start : 6 * rows.stop], {n: c[rows] for n, c in columns.items()})
    return np.linalg.lstsq(table[:, :-1], table[:, -1], rcond=None)[0]


def by_sindy() -> np.ndarray:
    """The same rows as the library of PySINDy's least squares without a threshold."""
    pysindy = pytest.importorskip("pysindy", reason="PySINDy is not installed")
    H, target = numpy_rows().rows(some(PIECE))
    optimizer = pysindy.STLSQ(threshold=0.0, alpha=0.0)
    optimizer.fit(H, target[:, None])
    return np.asarray(optimizer.coef_).ravel()


@cache
def reference() -> np.ndarray:
    """What lstsq makes of the piece."""
    return by_numpy(PIECE)


@cache
def size() -> np.ndarray:
    """Length of each column of the regressor."""
    return np.linalg.norm(numpy_rows().rows(some(PIECE))[0], axis=0)


def apart(theta: np.ndarray) -> float:
    """Largest distance to lstsq, of a parameter times its column, relative to the largest."""
    return float(np.max(np.abs(theta - reference()) * size()) / np.max(np.abs(reference()) * size()))


def extra_megabytes() -> float:
    """Memory that a solution takes beyond what was there: by the high-water mark of the process (Linux)."""
    own = Path("/proc/self")
    if not (own / "clear_refs").exists():
        pytest.skip("no high-water mark of memory here")
    columns = samples()
    solved([some(PIECE)])
    # A thread has a stack of its own that nobody has used before.
    thread = Thread(target=lambda: solved([columns]))
    (own / "clear_refs").write_text("5")
    before = _kilobytes("VmHWM")
    thread.start()
    thread.join()
    return (_kilobytes("VmHWM") - before) / 1024


def _kilobytes(name: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith(name)))


# --- measurements -------------------------------------------------------------------------------


def time_ours(speed: Speed) -> None:
    megabytes = extra_megabytes()
    found = solved([some(PIECE)])
    assert megabytes <= 1.0
    speed(
        REGRESSION,
        OURS,
        lambda: solved([samples()]),
        apart=apart(found),
        limit=LIMIT,
        rounds=20,
        more={"megabytes": megabytes},
    )


def time_numpy(speed: Speed) -> None:
    speed(REGRESSION, "NumPy and lstsq", by_numpy, rounds=1)


def time_sindy(speed: Speed) -> None:
    speed(
        REGRESSION,
        "NumPy and PySINDy",
        by_sindy,
        calls=PIECE / SAMPLES,
        apart=apart(by_sindy()),
        rounds=3,
        more={"measured_on": f"{PIECE} samples"},
    )


def time_pass(speed: Speed) -> None:
    columns = list(samples().values())
    speed(REGRESSION, "one pass over the data", lambda: [c.sum() for c in columns], rounds=20)


@pytest.mark.parametrize("count", [10**3, 10**4, 10**5, 10**6, 10**7])
def time_growth(speed: Speed, count: int) -> None:
    # The largest are the same million again and again.
    logs = [some(min(count, SAMPLES))] * max(1, count // SAMPLES)
    speed(GROWTH, OURS, lambda: solved(logs), size=count, rounds=5)
