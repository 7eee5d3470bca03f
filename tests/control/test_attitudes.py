"""Interval arithmetic, and verdicts over all attitudes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sm

from tests.quick import first_quick
from undertow import UndertowError, check_gains
from undertow.control.conditions import attitude
from undertow.control.conditions.attitude import BOUNDS, Attitudes, Interval, least_eigenvalue, margin_bound
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.problem import ALL, SAMPLED, Problem, Uncertainty
from undertow.control.conditions.result import HOLDS, UNPROVED
from undertow.control.gains import GainSet, GainTable, gains_from_table, load_gains
from undertow.control.plant import Plant
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

ROV = """
schema = "undertow/gains/1"
name = "rov"
law = "LAW"
[gains]
K_P = { x = 60, y = YY, z = 60, phi = 3, theta = 3, psi = 3 }
K_V = { x = 60, y = YY, z = 60, phi = 2, theta = 2, psi = 2 }
"""
RNG = np.random.default_rng(3)


@cache
def rov() -> Vehicle:
    return load_vehicle("bluerov2")


def rov_gains(folder: Path, law: str = "pd", sideways: float = 60.0) -> GainSet:
    path = folder / "gains.toml"
    path.write_text(ROV.replace("LAW", law).replace("YY", str(sideways)))
    return load_gains(path, rov())


# --- intervals --------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
def test_intervals_contain_their_functions(name: str) -> None:
    lo = RNG.uniform(-7, 7, 400)
    hi = lo + RNG.choice([1e-9, 0.01, 1.0, 8.0], 400)
    with np.errstate(over="ignore", invalid="ignore"):
        found = attitude.FUNCTIONS[name](Interval(lo, hi))
    for share in np.linspace(0, 1, 21):
        values = getattr(np, name)(lo + share * (hi - lo))
        assert np.all((found.lo <= values) & (values <= found.hi))
    narrow = hi - lo < 1e-8
    if name != "tan":
        assert np.all((found.hi - found.lo)[narrow] < 2e-8)


def test_products_of_interval_matrices_contain_the_products() -> None:
    a, b = RNG.normal(size=(2, 5, 4, 4))
    ra, rb = RNG.uniform(0, 0.3, (2, 5, 4, 4))
    found = Interval(a - ra, a + ra) @ Interval(b - rb, b + rb)
    for _ in range(50):
        u, v = RNG.uniform(-1, 1, (2, 5, 4, 4))
        product = (a + u * ra) @ (b + v * rb)
        assert np.all((found.lo <= product) & (product <= found.hi))


@pytest.mark.parametrize("size", [1.0, 1e-100, 1e100])
def test_rounding_stays_within_intervals(size: float) -> None:
    """Sums, products and matrix products of exact numbers, worked out in fractions."""
    a, b = RNG.normal(size=(2, 6, 6)) * np.array([size, 1.0])[:, None, None]
    exact = [[Fraction(v) for v in row] for row in a], [[Fraction(v) for v in row] for row in b]
    A, B = (Interval(m, m) for m in (a, b))
    yaw_invariant = [
        [sum(x * y for x, y in zip(row, c, strict=True)) for c in zip(*exact[1], strict=True)]
        for row in exact[0]
    ]
    each = {
        "+": (A + B, [[x + y for x, y in zip(*rows, strict=True)] for rows in zip(*exact, strict=True)]),
        "*": (A * B, [[x * y for x, y in zip(*rows, strict=True)] for rows in zip(*exact, strict=True)]),
        "@": (A @ B, yaw_invariant),
    }
    for found, values in each.values():
        for k in np.ndindex(6, 6):
            assert Fraction(found.lo[k]) < values[k[0]][k[1]] < Fraction(found.hi[k])
            assert found.hi[k] - found.lo[k] <= 1e-13 * max(size, 1.0)
    assert (A.radius == 0).all()


def test_least_eigenvalue_of_intervals_is_below_that_of_every_matrix_within() -> None:
    middle = RNG.normal(size=(30, 5, 5))
    middle = middle + np.swapaxes(middle, 1, 2)
    radius = RNG.uniform(0, 0.2, (30, 5, 5))
    bound = least_eigenvalue(Interval(middle - radius, middle + radius))
    for _ in range(50):
        inside = middle + RNG.uniform(-1, 1, middle.shape) * radius
        assert np.all(least_eigenvalue(inside) >= bound)
    exact = least_eigenvalue(Interval(middle, middle))
    np.testing.assert_allclose(exact, least_eigenvalue(middle), atol=1e-12)


# --- attitudes --------------------------------------------------------------------------------------
def test_a_level_vehicle_needs_no_sampling_of_headings() -> None:
    problem = Problem(load_gains("paper-pid", load_vehicle("mini-auv")))
    assert problem.attitudes.orthogonal
    assert problem.attitudes.heading_factors_out
    psi = sm.Symbol("psi", real=True)
    plant = problem.plant
    M_q = plant.with_signs(plant.J_inverse.T * plant.M * plant.J_inverse, dict.fromkeys(plant.reversing, 1))
    filled = M_q.xreplace(plant.numbers)
    of_M = np.linalg.eigvalsh(problem.sets[0].inertia)
    for heading in np.linspace(-3, 3, 7):
        yaw_invariant = np.array(filled.xreplace({psi: sm.Float(heading)}).tolist(), dtype=float)
        np.testing.assert_allclose(np.linalg.eigvalsh(yaw_invariant), of_M, rtol=1e-12)


SURGE_HEAVE_PITCH = """
schema = "undertow/vehicle/1"
name = "four"
degrees_of_freedom = ["surge", "sway", "heave", "pitch"]
signs = "sname"
[effects.rigid_body]
m = 20.0
I_y = 1.0
[effects.linear_damping]
X_u = -1.0
Y_v = -1.0
Z_w = -30.0
M_q = -1.0
"""


def test_pitch_counts_where_gains_tell_depth_from_the_level_though_j_is_a_rotation(tmp_path: Path) -> None:
    """Pitched by 60 degrees, heave damps surge, too: K_V + R D R' is less than on an even keel."""
    (tmp_path / "v.toml").write_text(SURGE_HEAVE_PITCH)
    rows = {"K_P": [20.0, 20.0, 2.0, 2.0], "K_V": [10.0, 10.0, 1.0, 9.0]}
    gains = {name: dict(zip(("x", "y", "z", "theta"), row, strict=True)) for name, row in rows.items()}
    axes = ["surge", "sway", "heave", "pitch"]
    table = {"schema": "undertow/gains/1", "name": "four", "law": "pd", "unactuated": axes, "gains": gains}
    problem = Problem(gains_from_table(GainTable.model_validate(table), load_vehicle(tmp_path / "v.toml")))
    (damper,) = (c for c in problem.conditions if c.form == "derived" and c.id == "K_V + D")
    found = problem.certificate(damper, problem.sets[0], None)
    turn = np.array([[0.5, np.sqrt(0.75)], [-np.sqrt(0.75), 0.5]])
    block = np.diag([10.0, 1.0]) + turn @ np.diag([1.0, 30.0]) @ turn.T
    margin_bound = np.linalg.eigvalsh(block)[0]
    assert 0.1 * margin_bound < found.bound <= found.least == pytest.approx(margin_bound, rel=1e-6)


def test_euler_angles_are_bounded_by_interval_arithmetic() -> None:
    """The bound is below 2000 random attitudes and the attitude shown is the worst of them."""
    attitudes = Attitudes(Plant(rov()), np.radians(60))
    assert not attitudes.orthogonal
    assert attitudes.heading_factors_out
    weight = np.diag([20.0, 25, 30, 0.3, 0.4, 0.5])

    def margin(inverse: np.ndarray | Interval) -> np.ndarray:
        turn = inverse.T if isinstance(inverse, Interval) else np.swapaxes(inverse, 1, 2)
        return least_eigenvalue(turn @ weight @ inverse)

    found = margin_bound(margin, attitudes, yaw_invariant=True)
    assert 0 < found.bound <= found.least
    assert found.bound > 0.9 * BOUNDS.share * found.least
    drawn = RNG.uniform(-1, 1, (2000, 3)) * [np.pi / 3, np.pi / 3, np.pi]
    angles = dict(zip(("phi", "theta", "psi"), drawn.T, strict=True))
    values = margin(attitudes.inverse({a: Interval(v, v) for a, v in angles.items()}).middle)
    assert min(values) >= found.least * (1 - 1e-9)
    assert abs(found.worst["theta"]) == pytest.approx(np.pi / 3, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("sideways", first_quick([60.0, 50.0]))
def test_pd_on_six_degrees_of_freedom(sideways: float, tmp_path: Path) -> None:
    """With other gains to the side the heading matters, and is searched as well."""
    found = certify(rov_gains(tmp_path, "pd", sideways), Uncertainty(rov()), forms=["derived"])
    assert found.ok
    (row,) = [r for r in found.rows if r.condition == "K_V + D" and r.scope == "matrices"]
    assert "interval arithmetic" in row.where
    assert row.where.startswith("least near phi")
    assert ("psi" in row.where) == (sideways != 60.0)


@pytest.mark.slow
def test_sampled_attitudes_settle_nothing_over_the_uncertainty(tmp_path: Path) -> None:
    """The nominal verdict is proved by intervals; over the parameters a few attitudes are tried only."""
    vehicle = rov()
    known = {n: replace(v, sigma=1e-6) for n, v in vehicle.values.items() if n == "K_p"}
    assert known
    vehicle = vehicle.with_values(known)
    path = tmp_path / "gains.toml"
    rov_gains(tmp_path)
    found = certify(load_gains(path, vehicle), Uncertainty(vehicle), forms=["derived"])
    rows = {r.scope: r for r in found.rows if r.condition == "K_V + D"}
    for scope, verdict in (("matrices", SAMPLED), ("phi", ALL)):
        box = rows[scope].box
        assert box is not None
        assert (rows[scope].verdict, box.verdict) == (HOLDS, verdict)


@pytest.mark.slow
def test_a_bound_that_is_not_settled_is_no_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attitude, "BOUNDS", replace(attitude.BOUNDS, first_boxes=1, max_boxes=1))
    gains = rov_gains(tmp_path, "pd", 10.0)
    found = certify(gains, Uncertainty(rov()), forms=["derived"], tilt=np.radians(80))
    (row,) = [r for r in found.rows if r.condition == "K_V + D" and r.scope == "matrices"]
    assert row.margin > 0
    assert row.verdict == UNPROVED
    assert "NOT proved" in row.where
    assert not found.conditions_hold


@pytest.mark.slow
def test_an_attitude_at_which_a_condition_fails_is_shown(tmp_path: Path) -> None:
    """A gain that the damping of roll just outweighs on an even keel is too much when pitched."""
    problem = Problem(rov_gains(tmp_path))
    condition = next(c for c in problem.conditions if c.id == "K_V + D")
    assert problem.certificate(condition, problem.sets[0], None).bound > 0
    weak = {**problem.values, "K_V": np.array([60.0, 60, 60, -0.0685, 2, 2])}
    found = problem.with_gains(weak).certificate(condition, problem.sets[0], None)
    assert problem.with_gains(weak).margin(condition, problem.sets[0], None, 3) > 0
    assert found.bound < 0
    assert abs(found.worst["theta"]) > np.arcsin(np.sqrt(0.0015 * 2.07) / 0.07) - 0.05


def test_a_proof_that_would_take_too_many_boxes_is_given_up_early() -> None:
    """What intervals make of M - M is wide, and only a millionth is left at every attitude."""
    attitudes = Attitudes(Plant(rov()), np.radians(60))

    def margin(inverse: np.ndarray | Interval) -> np.ndarray:
        turn = inverse.T if isinstance(inverse, Interval) else np.swapaxes(inverse, 1, 2)
        M = turn @ np.eye(6) @ inverse
        return least_eigenvalue(M - M + 1e-6 * np.eye(6))

    found = margin_bound(margin, attitudes, yaw_invariant=True)
    assert found.bound < 0 < found.least
    boxes = int(found.proof.split("on ")[-1].split()[0])
    assert BOUNDS.first_boxes < boxes < 4 * BOUNDS.first_boxes


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tilt": 95.0}, "up to 95 deg: give 1 to 85"),
        ({"tilt": -60.0}, "up to -60 deg"),
        ({"tilt": float("nan")}, "up to nan deg"),
        ({"confidence": 95.0}, "confidence 95 is no probability from 0.5"),
        ({"confidence": float("nan")}, "confidence nan"),
        ({"iota": 0.0}, "iota 0 is not positive"),
    ],
)
def test_what_no_certificate_can_cover_is_refused(options: dict[str, float], words: str) -> None:
    """Beyond 90 degrees of pitch J has no inverse, and yet 95 degrees passed as certified."""
    vehicle = load_vehicle("bluerov2")
    table = {"schema": "undertow/gains/1", "name": "pd", "law": "pd", "gains": {"K_P": 50.0, "K_V": 60.0}}
    gains = gains_from_table(GainTable.model_validate(table), vehicle)
    with pytest.raises(UndertowError, match=words):
        check_gains(vehicle, gains, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("backward", "holds"), first_quick([(2.0, True), (-30.0, True), (-75.0, False)]))
def test_a_condition_is_proved_in_all_sign_sets_at_once(backward: float, holds: bool, tmp_path: Path) -> None:
    """Also where damping backward is so much less than forward that what lies between fails."""
    values = {n: v for n, v in rov().values.items() if n not in ("Y_v", "Z_w", "N_r")}
    ways = {"Y_v": 80.0, "Z_w": 40.0, "N_r": 0.07}
    for name, forward in ways.items():
        values |= {f"{name}_forward": Value(-forward), f"{name}_backward": Value(-2.0 * forward)}
    values["Y_v_backward"] = Value(-backward)
    gains = replace(rov_gains(tmp_path, sideways=65.0), plant=Plant(replace(rov(), values=values)))
    problem = Problem(gains)
    condition = next(c for c in problem.conditions if c.id == "K_V + D")
    assert len(problem.relevant_sets) == 8
    each = [problem.certificate(condition, one, None).bound > 0 for one in problem.relevant_sets]
    assert problem.proved(condition, problem.relevant_sets, None) == all(each) == holds
    mixed = problem.relevant_sets[2:]  # the forward one is not among them
    assert problem.proved(condition, mixed, None) == all(each[2:])
