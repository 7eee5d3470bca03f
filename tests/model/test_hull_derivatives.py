"""Forces of hulls and rudders in manoeuvres, against the formulae that they are published with."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sm

from undertow.identification.diagnosis.candidates import candidates
from undertow.model.catalogue import catalogue
from undertow.model.symbols import VELOCITY, symbol
from undertow.model.vehicle import Thruster, Value, Vehicle

SHIP = ("surge", "sway", "yaw")
PROPELLER = Thruster("screw", (1.0, 0, 0, 0, 0, 0))
RUDDER = Thruster("rudder", (0, -1.0, 0, 0, 0, 3.5))


def force(
    effect_id: str, values: dict[str, float], nu: dict[str, float], **commands: float
) -> dict[str, float]:
    """Wrench of one effect on a vehicle with a propeller and a rudder."""
    names = ("screw", "rudder")
    ids = [*catalogue()[effect_id].requires, effect_id]
    effects = tuple(catalogue()[i](names) for i in ids)
    vehicle = Vehicle(
        "hull",
        ("surge", "sway", "heave", "roll", "pitch", "yaw"),
        effects,
        {n: Value(v) for n, v in values.items()},
        (PROPELLER, RUDDER),
    )
    wrench = next(w for e, w in vehicle.composition.wrenches.items() if e.id == effect_id)
    known = {symbol(n): vehicle.value_of(n).value for n in vehicle.parameter_names}
    known |= {symbol("rho"): 1000.0} | {symbol(n): nu.get(n, 0.0) for n in VELOCITY}
    known |= {symbol(f"actuation_{n}"): commands.get(n, 0.0) for n in names}
    known |= {symbol(n): commands.get(n, 0.0) for n in names}
    return dict(zip("XYZKMN", (float(x) for x in wrench.xreplace(known)), strict=True))


def test_a_rudder_drags_to_either_side_and_a_propeller_does_not() -> None:
    """MMG standard: X = -(1 - t_R) F_N sin(delta), with F_N = f u^2 delta and a small delta."""
    f, t_r, u, delta = 30.0, 0.387, 1.2, 0.05
    values = {"rudder_drag_rudder": (1 - t_r) * f, "rudder_drag_screw": 1e3}
    expected = -(1 - t_r) * f * u**2 * delta * np.sin(delta)
    for side in (1, -1):
        found = force("rudder_drag", values, {"u": u}, rudder=side * delta, screw=40.0)
        assert found["X"] == pytest.approx(expected, rel=1e-3)
        assert [found[c] for c in "YZKMN"] == [0] * 5
    assert force("rudder_drag", values, {"u": -u}, rudder=delta)["X"] > 0, "astern it brakes as well"


def test_the_flow_past_a_rudder_in_drift_lessens_its_drag() -> None:
    """MMG standard: F_N = f U_R^2 sin(alpha_R), alpha_R = delta - gamma_R (v + x_R r) / u, here with signs of
    a rudder that pushes to port at x_R = -3.5 m.
    """
    f, t_r, gamma = 30.0, 0.387, 0.6
    nu = {"u": 1.2, "v": 0.04, "r": -0.02}
    values = {"rudder_drag_rudder": (1 - t_r) * f, "rudder_inflow_rudder": (1 - t_r) * f * gamma}
    for delta in (0.05, -0.05):
        to_port = -(nu["v"] - 3.5 * nu["r"])
        normal = f * nu["u"] ** 2 * np.sin(delta - gamma * to_port / nu["u"])
        found = force("rudder_drag", values, nu, rudder=delta)["X"]
        assert found == pytest.approx(-(1 - t_r) * normal * np.sin(delta), rel=3e-3)


def test_a_rudder_in_a_slipstream_drags_without_speed() -> None:
    """What pushes by 20 N per radian along the hull's side, pushes astern by its sine where it turns."""
    for delta in (0.05, -0.05):
        found = force("rudder_drag", {"slipstream_drag_rudder": 20.0}, {}, rudder=delta)["X"]
        assert found == pytest.approx(-20.0 * delta * np.sin(delta), rel=1e-3)


def test_rudder_drag_is_sought_only_where_there_is_a_rudder_across_the_hull() -> None:
    names = ("screw", "rudder")
    effects = tuple(catalogue()[i](names) for i in ("rigid_body", "rudder_force"))
    ship = Vehicle("ship", SHIP, effects, {"m": Value(10.0)}, (PROPELLER, RUDDER))
    (found,) = candidates(ship, {"rudder_drag": catalogue()["rudder_drag"]})
    own = ["rudder_drag_rudder", "rudder_inflow_rudder", "slipstream_drag_rudder"]
    assert [p.name for p in found.parameters] == own
    without = Vehicle("ship", SHIP, effects[:1], {"m": Value(10.0)}, (PROPELLER, RUDDER))
    assert not candidates(without, {"rudder_drag": catalogue()["rudder_drag"]})


# Nondimensional derivatives of a full ship: the size of those of KVLCC2, every one with its sign.
PRIMED = {
    "Y": {"v": -0.315, "r": 0.083, "vvv": -1.607, "vvr": 0.379, "vrr": -0.391, "rrr": 0.008},
    "N": {"v": -0.137, "r": -0.049, "vvv": -0.030, "vvr": -0.294, "vrr": 0.055, "rrr": -0.013},
}
X_PRIMED = {"0": -0.022, "vv": -0.040, "vr": 0.002, "rr": 0.011, "vvvv": 0.771}
RHO, LENGTH, DRAUGHT = 1000.0, 7.0, 0.455


def published(u: float, v: float, r: float) -> dict[str, float]:
    """Hull forces of the MMG standard method: the polynomials, times rho/2 L d U^2."""
    speed = np.hypot(u, v)
    drift, turning = v / speed, r * LENGTH / speed
    scale = RHO / 2 * LENGTH * DRAUGHT * speed**2
    found = {
        axis: sum(c * drift ** n.count("v") * turning ** n.count("r") for n, c in terms.items())
        for axis, terms in PRIMED.items()
    }
    surge = sum(c * drift ** n.count("v") * turning ** n.count("r") for n, c in X_PRIMED.items())
    return {"X": scale * surge, "Y": scale * found["Y"], "N": scale * LENGTH * found["N"]}


def stated(u: float, v: float, r: float) -> dict[str, float]:
    """The same hull by effects of the catalogue, with the coefficients converted as hull_cubic says."""
    scale = RHO / 2 * LENGTH * DRAUGHT
    cubic: dict[str, float] = {"U_fade": 1e-3, "X_vvvv_per_UU": scale * X_PRIMED["vvvv"]}
    lift: dict[str, float] = {}
    for axis, terms in PRIMED.items():
        size = scale * (LENGTH if axis == "N" else 1.0)
        lift |= {f"{axis}_uv": size * terms["v"], f"{axis}_ur": size * LENGTH * terms["r"]}
        halves = {"vvv": terms["v"] / 2, "vvr": terms["r"] / 2}
        for n in ("vvv", "vvr", "vrr", "rrr"):
            value = size * LENGTH ** n.count("r") * (terms[n] + halves.get(n, 0.0))
            cubic[f"{axis}_{n}_per_U"] = value
    drag = {"X_vv": scale * (X_PRIMED["vv"] + X_PRIMED["0"])}
    drag |= {"X_vr": scale * LENGTH * X_PRIMED["vr"], "X_rr": scale * LENGTH**2 * X_PRIMED["rr"]}
    parts = {"lift": lift, "hull_cubic": cubic, "manoeuvring_drag": drag}
    parts["quadratic_damping"] = {"X_uabsu": scale * X_PRIMED["0"]}
    found = [force(i, values, {"u": u, "v": v, "r": r}) for i, values in parts.items()]
    return {axis: sum(f[axis] for f in found) for axis in "XYN"}


@pytest.mark.parametrize(("v", "r"), [(0.1, 0.02), (-0.25, 0.06), (0.3, -0.09), (-0.4, -0.05)])
def test_a_ship_of_the_mmg_standard_is_the_sum_of_four_effects(v: float, r: float) -> None:
    expected, found = published(1.1, v, r), stated(1.1, v, r)
    for axis in "XYN":
        # The conversion from U to u leaves out terms of fifth order in the drift.
        left_out = RHO / 2 * LENGTH * DRAUGHT * LENGTH * 0.4 * abs(v / 1.1) ** 5 * 1.1**2
        assert found[axis] == pytest.approx(expected[axis], rel=2e-3, abs=left_out)


def test_terms_of_high_order_fade_at_rest() -> None:
    values = {"N_rrr_per_U": -100.0, "Y_vvv_per_U": -100.0, "U_fade": 0.1}
    assert force("hull_cubic", values, {"r": 0.2})["N"] == pytest.approx(-100 * 0.2**3 / 0.1)
    assert force("hull_cubic", values, {})["Y"] == 0


def test_a_hull_of_one_section_drifting_while_it_turns_slowly() -> None:
    """Strip theory: the yaw moment per |v| r is -rho T L^3 / 12, the sway force per |v| v is -rho/2 T L."""
    length, height, v, r = 7.0, 0.4, 0.5, 0.01
    hull = {"T_cross": height, "B_cross": 0.0, "L_cross": length, "x_cross": 0.0}
    strips = force("crossflow_drag", hull, {"v": v, "r": r})
    terms = {"N_rabsv": -1000.0 * height * length**3 / 12}
    assert force("quadratic_damping_coupling", terms, {"v": v, "r": r})["N"] == pytest.approx(strips["N"])
    assert force("quadratic_damping_coupling", {"M_wabsw": 3.18}, {"w": -2.0})["M"] == pytest.approx(-12.72)


def test_a_hull_that_is_not_straight_pulls_with_the_square_of_the_speed() -> None:
    values = {"N_uabsu": 0.7, "Z_uabsu": -2.0}
    once, twice = (force("zero_angle_lift", values, {"u": u, "v": 0.3}) for u in (1.0, 2.0))
    assert (once["N"], once["Z"], once["X"]) == (0.7, -2.0, 0)
    assert twice["N"] == pytest.approx(4 * once["N"])


SERIES = [(i, physics) for i, effect in sorted(catalogue().items()) for physics in effect.series_of]
# A hull of 2 m in cross-flow, and motions of a craft that drifts and turns at speed: v and r.
CROSSFLOW = {"T_cross": 0.3, "L_cross": 2.0, "x_cross": 0.1}
MOTIONS = [(v, r) for v in np.linspace(-0.4, 0.4, 5) for r in np.linspace(-0.3, 0.3, 5)]


@pytest.mark.parametrize(("series", "physics"), SERIES)
def test_a_series_comes_close_to_the_physics_that_it_is_a_series_of(series: str, physics: str) -> None:
    """With the best coefficients, beside diagonal damping, a tenth of the mean square is left at the most."""
    values = {"crossflow_drag": CROSSFLOW}[physics]
    nus = [{"u": 1.0, "v": v, "r": r} for v, r in MOTIONS]
    wanted = [force(physics, values, nu) for nu in nus]
    for axis in "YN":
        own = [p.name for p in catalogue()[series]().parameters if p.linear and p.name[0] == axis]
        diagonal = [[v * abs(v) if axis == "Y" else r * abs(r)] for v, r in MOTIONS]
        columns = np.hstack([[[force(series, {n: 1.0}, nu)[axis] for n in own] for nu in nus], diagonal])
        target = np.array([w[axis] for w in wanted])
        left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        assert np.sum(left**2) < 0.1 * np.sum(target**2), axis


def test_the_righting_arm_of_vertical_sides() -> None:
    """Rawson and Tupper: GZ = (GM + BM tan^2(phi) / 2) sin(phi), against a hull of rectangular section cut by
    its waterline: B the middle of the part under water, its moments from the corners of the section.
    """
    beam, draught, kg = 2.0, 0.8, 0.6
    weight, bm = 1000 * 9.81 * beam * draught, beam**2 / (12 * draught)
    gm = draught / 2 + bm - kg
    box = Vehicle(
        "barge",
        ("roll",),
        tuple(catalogue()[i](()) for i in ("restoring", "nonlinear_restoring")),
        {"W": Value(weight), "B": Value(weight), "S_z": Value(gm * weight), "BM": Value(bm)},
    )
    phi = 0.3
    total = sum(box.composition.wrenches.values(), start=sm.zeros(1, 1))
    known = {symbol(n): box.value_of(n).value for n in box.parameter_names} | {symbol("phi"): phi}
    moment = float(total[0].xreplace(known | {symbol("theta"): 0.0}))
    # Wedges that go under and come out shift the centre of buoyancy sideways and up, from the keel's middle.
    across, up = bm * np.tan(phi), draught / 2 + bm * np.tan(phi) ** 2 / 2
    arm = across * np.cos(phi) + (up - kg) * np.sin(phi)
    assert moment == pytest.approx(-weight * arm, rel=1e-12)


def test_only_a_hull_that_floats_is_asked_for_its_waterline() -> None:
    effect = catalogue()["nonlinear_restoring"]
    assert effect.observable_in(("surge", "sway", "roll", "yaw"))
    assert not effect.observable_in(("heave", "roll", "pitch"))
    assert not effect.observable_in(("surge", "sway", "yaw"))
