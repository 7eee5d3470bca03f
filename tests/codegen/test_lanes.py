"""Lanes: the same text for one, four and eight runs at once, against plain C and mpmath."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path

import casadi as ca
import mpmath
import numpy as np
import pytest

from tests.codegen.support import BUNDLED, functions_of, random_point
from tests.codegen.test_plain import OPERATIONS, A, B
from tests.quick import first_quick
from undertow.codegen.compiler import LANES, Compiler, plain_c
from undertow.codegen.engine import LANES_HEADER

COUNTS = (1, 4, 8)
# What a kink, a comparison or a root may take another way.
AWKWARD = [
    0.0,
    -0.0,
    math.inf,
    -math.inf,
    math.nan,
    1.0,
    -1.0,
    0.5,
    -2.5,
    1e-310,
    3e15,
    -4503599627370497.5,
    1e300,
]
KINKS = ca.vertcat(
    *(ca.fabs(A), ca.sign(A), ca.fmin(A, B), ca.fmax(A, B), ca.floor(A), ca.sqrt(A)),
    *(A < B, A <= B, A == B, A != B, ca.logic_and(A, B), ca.logic_or(A, B), ca.logic_not(A)),
    *(ca.if_else(A, B, 2), ca.if_else(A > 0, A, -B), 1 / A, -A),
)
# f over n columns: column i of x is what run i is given, lanes columns at a time.
OVER = """
__attribute__((visibility("default"))) void over(int n, const double *x, double *y) {
  Real a[NX], b[NY];
  for (int i = 0; i < n; i += LANES) {
    for (int j = 0; j < NX; j++)
      for (int l = 0; l < LANES; l++) LANE(a[j], l) = x[j * n + i + l];
    f(a, b);
    for (int j = 0; j < NY; j++)
      for (int l = 0; l < LANES; l++) y[j * n + i + l] = LANE(b[j], l);
  }
}
"""


def over(
    function: ca.Function, lanes: int, columns: np.ndarray, compiler: Compiler, folder: Path
) -> np.ndarray:
    """A function of one vector over the columns of an array, by compiled code of so many lanes."""
    nx, ny, n = function.size1_in(0), function.size1_out(0), columns.shape[1]
    assert n % lanes == 0
    head = f"#define LANES {lanes}\n#define NX {nx}\n#define NY {ny}\n{LANES_HEADER}"
    source = folder / f"lanes{lanes}.c"
    source.write_text(head + plain_c(function, "f", prefix="static ", words=LANES) + OVER)
    compiler.build(source, source.with_suffix(".so"))
    x, y = np.ascontiguousarray(columns, dtype=float), np.empty((ny, n))
    run = ctypes.CDLL(str(source.with_suffix(".so"))).over
    run(n, ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data))
    return y


def padded(columns: np.ndarray) -> np.ndarray:
    """The columns and the first ones again, so that their number is a multiple of all numbers of lanes."""
    return columns[:, np.arange(-(-columns.shape[1] // 8) * 8) % columns.shape[1]]


@pytest.mark.parametrize("lanes", COUNTS)
def test_every_operation_is_casadis(lanes: int, c_compiler: Compiler, tmp_path: Path) -> None:
    function = ca.Function("f", [ca.vertcat(A, B)], [ca.vertcat(*OPERATIONS.values())], ["x"], ["y"])
    values = [-2.5, -1.0, -0.3, 0.4, 1.0, 1.7]
    x = padded(np.array([(a, b) for a in values for b in values]).T)
    found = over(function, lanes, x, c_compiler, tmp_path)
    expected = np.array(function.map(x.shape[1])(x))
    for name, row, wanted in zip(OPERATIONS, found, expected, strict=True):
        np.testing.assert_allclose(row, wanted, rtol=1e-14, err_msg=name)


@pytest.mark.parametrize("lanes", COUNTS)
def test_kinks_are_those_of_plain_c(lanes: int, c_compiler: Compiler, tmp_path: Path) -> None:
    function = ca.Function("f", [ca.vertcat(A, B)], [KINKS], ["x"], ["y"])
    x = padded(np.array([(a, b) for a in AWKWARD for b in AWKWARD]).T)
    (tmp_path / "it.c").write_text(
        '#include <math.h>\n__attribute__((visibility("default")))\n' + plain_c(function, "f")
    )
    c_compiler.build(tmp_path / "it.c", tmp_path / "it.so")
    plain, expected = ctypes.CDLL(str(tmp_path / "it.so")), np.empty((KINKS.numel(), x.shape[1]))
    for i in range(x.shape[1]):
        column, y = np.ascontiguousarray(x[:, i]), np.empty(KINKS.numel())
        plain.f(ctypes.c_void_p(column.ctypes.data), ctypes.c_void_p(y.ctypes.data))
        expected[:, i] = y
    found = over(function, lanes, x, c_compiler, tmp_path)
    for k, (row, wanted) in enumerate(zip(found, expected, strict=True)):
        reported = np.isnan(wanted)
        assert np.array_equal(np.isnan(row), reported), k
        assert np.array_equal(row[~reported].view(np.int64), wanted[~reported].view(np.int64)), str(KINKS[k])


def angles() -> np.ndarray:
    """Numbers of every size, those next to multiples of a quarter turn, and what is no angle."""
    rng = np.random.default_rng(5)
    spread = np.concatenate(
        [rng.uniform(-r, r, 500) for r in (1e-8, 1e-3, 0.8, 10, 1e3, 1e4, 2e4, 1e6, 1e12)]
    )
    quarters = np.arange(-9000, 9001, 17) * (math.pi / 2)
    near = np.concatenate([quarters, np.nextafter(quarters, np.inf), np.nextafter(quarters, -np.inf)])
    special = [0.0, -0.0, math.inf, -math.inf, math.nan, 1e300, 5e-324, 2e4, np.nextafter(2e4, 3e4)]
    return padded(np.concatenate([special, near, spread])[None])


def exact(angle: np.ndarray) -> tuple[list[mpmath.mpf], list[mpmath.mpf]]:
    with mpmath.workprec(1100 if np.abs(angle).max() > 1e100 else 160):
        return [mpmath.sin(float(a)) for a in angle], [mpmath.cos(float(a)) for a in angle]


@pytest.mark.parametrize("lanes", COUNTS)
def test_sines_are_right_to_two_units_in_the_last_place(
    lanes: int, c_compiler: Compiler, tmp_path: Path
) -> None:
    function = ca.Function("f", [A], [ca.vertcat(ca.sin(A), ca.cos(A), ca.tan(A))], ["x"], ["y"])
    x = angles()
    sine, cosine, _ = over(function, lanes, x, c_compiler, tmp_path)
    ordinary = np.isfinite(x[0]) & (np.abs(x[0]) < 1e13)
    for found, expected in zip((sine, cosine), exact(x[0, ordinary]), strict=True):
        with mpmath.workprec(160):
            off = [abs(mpmath.mpf(float(f)) - e) for f, e in zip(found[ordinary], expected, strict=True)]
        units = np.array([float(o) for o in off]) / np.spacing(np.abs(np.array([float(e) for e in expected])))
        assert units.max() <= 2.0, units.max()


@pytest.mark.parametrize("lanes", COUNTS)
def test_what_is_no_ordinary_angle(lanes: int, c_compiler: Compiler, tmp_path: Path) -> None:
    function = ca.Function("f", [A], [ca.vertcat(ca.sin(A), ca.cos(A), ca.tan(A))], ["x"], ["y"])
    x = padded(np.array([[0.0, -0.0, math.inf, 1.0, math.nan, 1e300, 5e-324, -math.inf, 0.5]]))
    found = over(function, lanes, x, c_compiler, tmp_path)
    with np.errstate(invalid="ignore"):
        expected = np.array([np.sin(x[0]), np.cos(x[0]), np.tan(x[0])])
    np.testing.assert_allclose(found, expected, rtol=4e-16, atol=0)
    assert np.array_equal(np.signbit(found[0, :2]), [False, True])


@pytest.mark.parametrize("name", first_quick([*BUNDLED, "full"], 2))
def test_dynamics_are_those_of_the_virtual_machine(name: str, c_compiler: Compiler, tmp_path: Path) -> None:
    dynamics = functions_of(name).dynamics
    symbols = [ca.SX.sym(n, dynamics.size1_in(n)) for n in dynamics.name_in()]
    together = ca.Function("f", [ca.vertcat(*symbols)], [dynamics(*symbols)], ["x"], ["y"])
    points = [random_point(functions_of(name), seed) for seed in range(8)]
    x = np.array([[*p.x, *p.u, *p.p, p.t] for p in points]).T
    expected = np.array(dynamics.map(8)(*np.split(x, np.cumsum([s.numel() for s in symbols])[:-1])))
    scale = np.abs(expected).max(axis=0)
    found = [over(together, lanes, x, c_compiler, tmp_path) for lanes in COUNTS]
    assert np.isfinite(expected).all()
    assert (np.abs(found[0] - expected) <= 1e-13 * scale).all()
    # Nothing but the order of the same operations could differ, and it does not.
    assert np.array_equal(found[1], found[0])
    assert np.array_equal(found[2], found[0])
