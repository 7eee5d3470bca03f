"""The conditions on gains against numbers worked out by hand for the published gains (Tables 4 and 5)."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import sympy as sm

from tests.quick import first_quick
from undertow.control.conditions.by_law import CONDITIONS, Quantities
from undertow.control.conditions.channels import roots, routh_array
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.problem import Problem, Uncertainty
from undertow.control.conditions.repair import KINDS, Repair, single_repairs
from undertow.control.conditions.repair import repair as repaired
from undertow.control.conditions.result import Report, Row
from undertow.control.gains import load_gains
from undertow.model.loading import load_vehicle

SIX = 1e-6
"""Numbers are compared to six digits."""


@cache
def problem(gains: str = "paper-pid") -> Problem:
    return Problem(load_gains(gains, load_vehicle("mini-auv")))


@cache
def report(gains: str = "paper-pid") -> Report:
    vehicle = load_vehicle("mini-auv")
    return certify(load_gains(gains, vehicle), Uncertainty(vehicle))


@cache
def repair(kind: str) -> Repair:
    return repaired(problem(), kind)


def row(form: str, condition: str, scope: str, signs: str, gains: str = "paper-pid") -> Row:
    (found,) = [
        r
        for r in report(gains).rows
        if (r.form, r.condition, r.scope) == (form, condition, scope) and r.signs in (signs, "both")
    ]
    return found


# --- as printed -------------------------------------------------------------------------------------
@pytest.mark.parametrize(("signs", "right"), first_quick([("forward", 10.088308), ("backward", 11.408386)]))
def test_printed_damper(signs: str, right: float) -> None:
    found = row("printed", "K_V", "matrices", signs)
    assert (found.left, found.verdict) == (0.005, "fails")
    assert found.right == pytest.approx(right, rel=SIX)
    passing = [c for c in ("x", "y", "z", "psi") if row("printed", "K_V", c, signs).verdict == "holds"]
    assert passing == ["psi"]


@pytest.mark.parametrize("signs", ["forward", "backward"])
def test_printed_spring_fails_for_every_iota_and_holds_in_x_above_one(signs: str) -> None:
    assert row("printed", "K_I", "matrices", signs).verdict == "holds"
    everywhere = row("printed", "K_P", "matrices", signs)
    assert (everywhere.iota, everywhere.verdict) == (None, "no iota")
    alone = row("printed", "K_P", "x", signs).iota
    assert alone is not None
    assert alone[0] == pytest.approx(0.0857143, rel=SIX)
    assert math.isinf(alone[1])


@pytest.mark.parametrize(("signs", "inertia"), [("forward", 9.130825), ("backward", 9.432838)])
def test_printed_last_condition_asks_for_another_iota_in_x(signs: str, inertia: float) -> None:
    """(1 - iota) 0.012/2 = iota m_x: K_P/(2 M + K_P) is 0.000656683 and 0.000635671."""
    alone = row("printed", "last", "x", signs).iota
    assert alone is not None
    assert alone[0] == 0.0
    assert alone[1] == pytest.approx(0.006 / (inertia + 0.006), rel=1e-9)
    assert alone[1] == pytest.approx({"forward": 0.000656683, "backward": 0.000635671}[signs], rel=SIX)


def test_no_iota_serves_any_form() -> None:
    assert {a.form: a.iota for a in report().agreements} == {"printed": None, "units": None, "derived": None}
    assert not report().ok


# --- derived ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("channel", "signs", "span"),
    [
        ("z", "forward", (0.000500637, 0.282722)),
        ("z", "backward", (0.000500667, 0.267659)),
        ("psi", "forward", (0.00537171, 0.0695662)),
        ("psi", "backward", (0.00537171, 0.0695662)),
        ("x", "forward", None),
        ("x", "backward", None),
    ],
)
def test_derived_condition_by_channel(channel: str, signs: str, span: tuple[float, float] | None) -> None:
    found = row("derived", "V_dot", channel, signs).iota
    assert found == (span if span is None else pytest.approx(span, rel=2 * SIX))
    assert (row("derived", "some iota", channel, signs).verdict == "holds") == (span is not None)


@pytest.mark.parametrize(
    ("signs", "margin", "pair"),
    [("forward", -0.000971575, 0.003198 + 0.038054j), ("backward", -0.001677419, 0.005482 + 0.038392j)],
)
def test_the_published_surge_loop_is_unstable(signs: str, margin: float, pair: complex) -> None:
    assert row("derived", "Routh", "x", signs).margin == pytest.approx(margin, rel=SIX)
    (surge,) = [c for c in report().channels if (c.coordinate, c.signs) == ("x", signs)]
    assert not surge.stable
    assert surge.roots[0] == pytest.approx(pair, abs=5e-7)
    assert surge.roots[1] == pytest.approx(pair.conjugate(), abs=5e-7)
    assert all(c.stable for c in report().channels if c.coordinate != "x")


def test_pd_holds_and_sway_is_left_alone() -> None:
    found = report("paper-pd")
    assert {r.verdict for r in found.rows} == {"holds"}
    assert all(c.stable for c in found.channels)
    assert found.zero_dynamics is not None
    assert found.zero_dynamics.axes == ("sway",)
    assert "x: -sin(psi), y: cos(psi)" in found.lyapunov.invariant
    assert found.region.kind == "none"


def test_damping_ratio_of_pd_surge() -> None:
    surge = {c.signs: c for c in report("paper-pd").channels if c.coordinate == "x"}
    ratio = {s: -c.roots[0].real / abs(c.roots[0]) for s, c in surge.items()}
    assert ratio == pytest.approx({"forward": 0.792650, "backward": 0.761194}, rel=SIX)


def test_sliding_mode_reaches_although_the_weight_is_uncertain() -> None:
    found = report("paper-smc")
    assert {r.verdict for r in found.rows} == {"holds"}
    heave = row("derived", "reaching", "z", "forward", "paper-smc")
    assert heave.left == pytest.approx(10.088308, rel=SIX)
    assert heave.right == pytest.approx(1.959963985 * 0.41, rel=SIX)


# --- gains that tell north from east ----------------------------------------------------------------
@pytest.mark.slow
def test_gains_that_are_good_heading_north_only_are_refused() -> None:
    """Heading east, the stiff gains of y act on surge: M k_i > K k_p there."""
    vehicle = load_vehicle("mini-auv")
    gains = load_gains("paper-pid", vehicle)
    good = {"K_P_x": 0.2, "K_V_x": 2.0, "K_P_y": 0.2, "K_I_y": 0.05, "K_P_psi": 0.1}
    found = certify(replace(gains, values={**gains.values, **good}), Uncertainty(vehicle), forms=["derived"])
    stable = {(c.coordinate, c.signs): c.stable for c in found.channels}
    assert stable["x", "forward"]
    assert stable["y", "both"]
    assert not stable["y heading east", "forward"]
    (worst,) = [roots for name, roots in found.coupled.items() if name.startswith("forward")]
    assert "forward, worst of 18 headings: 90 deg" in found.coupled
    surge = np.roots([9.130825, 0.142306 + 0.005, 0.2, 0.05])
    assert worst[0].real >= max(surge.real) - 1e-9
    assert not found.conditions_hold
    mended = repaired(Problem(replace(gains, values={**gains.values, **good})), "routh")
    assert mended.gains  # something has to change


# --- repairs ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("kind", "gain", "forward", "backward"),
    [
        ("routh", "K_V", 0.0859646, 0.144785),
        ("routh", "K_I", 1.93594e-4, 1.22172e-4),
        ("lyapunov", "K_P", 0.025243, 0.034834),
        ("lyapunov", "K_I", 1.24504e-4, 9.19227e-5),
        ("lyapunov", "K_V", None, None),
    ],
)
def test_one_gain_alone(kind: str, gain: str, forward: float | None, backward: float | None) -> None:
    found = {
        s.signs: s for s in single_repairs(problem()) if (s.kind, s.gain, s.coordinate) == (kind, gain, "x")
    }
    for signs, bound in (("forward", forward), ("backward", backward)):
        got = found[signs].bound
        assert got == bound if bound is None else got == pytest.approx(bound, abs=0.6 * _last_digit(bound))
        assert bound is None or found[signs].above == (gain != "K_I")


def _last_digit(number: float) -> float:
    """One unit of the last digit that a number is written with."""
    mantissa, _, exponent = f"{number!r}".partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def test_literal_repair_asks_for_far_too_much() -> None:
    found = repair("literal")
    assert min(found.gains["K_V"].values()) == pytest.approx(11.408386, rel=SIX)
    assert max(found.gains["K_P"].values()) == pytest.approx(11.411385, rel=SIX)
    assert found.iota == pytest.approx(0.33339, abs=5e-6)
    force, moment = found.gains["K_P"]["x"] * math.sqrt(2), found.gains["K_P"]["psi"] * math.radians(135)
    assert (round(force), round(moment, 1)) == (16, 26.9)


@pytest.mark.parametrize("kind", first_quick(KINDS))
def test_repaired_gains_satisfy_what_they_were_repaired_for(kind: str) -> None:
    found, here = repair(kind), problem()
    values = {name: v.copy() for name, v in here.values.items()}
    for name, changed in found.gains.items():
        for coordinate, value in changed.items():
            values[name][here.coordinates.index(coordinate)] = value
    there = here.with_gains(values)
    for condition in KINDS[kind].conditions:
        for one in there.sets:
            if condition.per_channel_only:
                assert all(there.margin(condition, one, None, i) > 0 for i in range(4))
            else:
                assert there.margin(condition, one, found.iota) > 0


@pytest.mark.parametrize("kind", KINDS)
def test_the_digits_that_are_printed_repair(kind: str) -> None:
    found, here = repair(kind), problem()
    values = {name: v.copy() for name, v in here.values.items()}
    for name, changed in found.gains.items():
        for coordinate, value in changed.items():
            values[name][here.coordinates.index(coordinate)] = float(f"{value:.6g}")
    there = here.with_gains(values)
    conditions = [c for c in KINDS[kind].conditions if not c.per_channel_only]
    assert not conditions or there.iota_interval(conditions, there.relevant_sets) is not None
    for condition in {*KINDS[kind].conditions} - {*conditions}:
        assert all(there.margin(condition, one, None, i) > 0 for one in there.sets for i in range(4))


def test_the_repair_is_the_smallest_in_a_case_with_a_closed_form() -> None:
    """Backward surge: the nearest point of k_p K = m k_i, by a search over k_p and k_v."""
    found = repair("routh")
    m, d, p0, v0, i0 = 9.432838, 0.091036, 0.012, 0.005, 0.0003
    p, v = np.meshgrid(np.linspace(p0, 2 * p0, 1501), np.linspace(v0, 1.5 * v0, 401))
    i = np.minimum(p * (v + d) / m, i0)
    # The change of k_i counts as twice that of its root.
    cost = (p / p0 - 1) ** 2 + (v / v0 - 1) ** 2 + (2 * np.sqrt(i / i0) - 2) ** 2
    best = np.unravel_index(cost.argmin(), cost.shape)
    assert found.gains["K_P"]["x"] == pytest.approx(p[best], rel=2e-3)
    assert found.gains["K_I"]["x"] == pytest.approx(i[best], rel=2e-3)


# --- how it is worked out ---------------------------------------------------------------------------
def test_some_iota_is_where_the_block_is_definite_and_implies_the_rest() -> None:
    """The determinant of the block is a parabola in iota whose discriminant gives the condition."""
    M, K, p, i, iota = sm.symbols("M K k_p k_i iota", positive=True)
    s = Quantities({"M": M, "D": sm.Integer(0), "K_V": K, "K_P": p, "K_I": i, "iota": iota})
    block = next(c for c in CONDITIONS["pid"] if c.id == "V_dot").left(s)
    some = next(c for c in CONDITIONS["pid"] if c.id == "some iota")
    parabola = sm.Poly(sm.expand(block.det()), iota)
    gap = sm.expand(some.left(s) ** 2 - some.right(s) ** 2)
    assert sm.expand(parabola.discriminant() - gap) == 0
    # V > 0 follows: det > 0 says iota p - i > iota^2 K^2/(4 (K - iota M)), and that is at least iota^3 M.
    assert sm.factor(K**2 - 4 * iota * M * (K - iota * M)) == (K - 2 * M * iota) ** 2
    # Routh follows, because the right side is not negative.
    assert some.right(s).is_positive


def test_conditions_with_units_mended_imply_the_derived_ones_without_damping() -> None:
    rng = np.random.default_rng(1)
    units, derived = (
        [c for c in CONDITIONS["pid"] if c.form == f and not c.per_channel_only] for f in ("units", "derived")
    )
    held = 0
    for _ in range(4000):
        drawn = 10 ** rng.uniform(-2, 2, 5)
        quantities = dict(zip(("M", "K_V", "K_P", "K_I", "iota"), drawn.reshape(5, 1, 1), strict=True))
        s = Quantities({**quantities, "iota": float(drawn[4]), "D": np.zeros((1, 1))})
        if all(c.margin(s) > 0 for c in units):
            held += 1
            assert all(c.margin(s) > 0 for c in derived)
    assert held > 20


def _sign_changes(coefficients: list[float]) -> int:
    """Roots in the open right half-plane, by the first column of the Routh array."""
    first = [row[0] for row in routh_array(coefficients)]
    return sum(a * b < 0 for a, b in pairwise(first))


def test_routh_array() -> None:
    M, K, p, i = sm.symbols("M K k_p k_i", positive=True)
    assert str(sm.simplify(routh_array([M, K, p, i])[2][0])) == "k_p - M*k_i/K"
    assert [r[0] for r in routh_array([1, 6, 11, 6])] == [1, 6, 10, 6]
    rng = np.random.default_rng(2)
    for degree in (2, 3, 4, 5, 6):
        polynomial = list(np.poly(rng.normal(size=degree)))
        assert _sign_changes(polynomial) == sum(r.real > 0 for r in roots(polynomial))
    assert _sign_changes([1, 1, 2, 2, 3]) == 2  # a zero at the beginning of a row


MIXED = """
schema = "undertow/vehicle/1"
name = "mixed signs"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
[effects.rigid_body]
m = 1.0
I_z = 1.0
[effects.added_mass]
X_udot = { forward = -0.20430777, backward = -13.98785491 }
Y_vdot = { forward = -30.3711721, backward = -20.42131082 }
N_rdot = -1.0
[effects.linear_damping]
X_u = { forward = -1.25828135, backward = -0.21674305 }
Y_v = { forward = -8.92878855, backward = -1.0921851 }
N_r = -2.0
"""
MIXED_GAINS = """
schema = "undertow/gains/1"
name = "mixed signs"
law = "pid"
[gains]
K_P = { x = 20.98575117, y = 60.59404895, psi = 4.0 }
K_V = { x = 0.56771486, y = 23.25238354, psi = 4.0 }
K_I = { x = 0.71280736, y = 57.63618638, psi = 0.4 }
"""


def test_axes_that_move_in_different_directions_have_poles_of_their_own(tmp_path: Path) -> None:
    """Found by a search: stable all forward and all backward, not with surge ahead and sway astern."""
    thrusters = "".join(
        f'[[thrusters]]\nname = "{name}"\nwrench = {[float(i == axis) for i in range(6)]}\n'
        for name, axis in (("a", 0), ("b", 1), ("c", 5))
    )
    (tmp_path / "v.toml").write_text(MIXED + thrusters)
    (tmp_path / "g.toml").write_text(MIXED_GAINS)
    report = certify(load_gains(tmp_path / "g.toml", load_vehicle(tmp_path / "v.toml")), forms=["derived"])
    growth = {name: roots[0].real for name, roots in report.coupled.items()}
    both = [g for name, g in growth.items() if name.startswith(("forward", "backward"))]
    mixed = [g for name, g in growth.items() if name.startswith("u ")]
    assert len(both) == 2
    assert max(both) == pytest.approx(-0.00898, abs=1e-4)
    assert max(mixed) == pytest.approx(0.0097, abs=1e-4)
    assert not report.ok
