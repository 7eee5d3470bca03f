"""Physical consistency: the mass matrix stays positive, damping takes energy, equalities hold exactly."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, minimize

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, vehicle_of, with_effect
from tests.identification.surge import surge_run, surge_vehicle
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.errors import UndertowError
from undertow.identification.diagnosis.bench import noise_ratio
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import verdicts
from undertow.identification.estimation.output_error import fit_output_error
from undertow.identification.estimation.pointwise import added_mass_at_zero_frequency
from undertow.identification.estimation.residual import JointLimits, Linearised, WeakModel
from undertow.identification.estimation.step import (
    Constraints,
    bounds_of,
    limited_step,
    nearest_physical,
    prior_of,
    read_equalities,
)
from undertow.identification.estimation.weak_form import fit_under_noise, fit_weak
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import VehicleTable, vehicle_from_table
from undertow.model.vehicle import Vehicle

NOTHING = np.zeros(3), np.zeros(3)


def sway_yaw(m: float, inertia: float, coupling: float, **damping: float) -> Vehicle:
    """Sway and yaw with coupled inertia and coupled damping; SNAME signs, forces in the log."""
    coefficients = {"Y_v": -8.0, "N_r": -2.0, "Y_r": 0.0, "N_v": 0.0} | damping
    free = {n: {"value": v, "estimate": True} for n, v in coefficients.items()}
    table = {
        "schema": "undertow/vehicle/1",
        "name": "two",
        "degrees_of_freedom": ["sway", "yaw"],
        "signs": "sname",
        "generalised_forces": ["tau_Y", "tau_N"],
        "effects": {
            "rigid_body": {"m": m, "I_z": inertia},
            "added_mass": {"Y_vdot": -1.0, "N_rdot": -0.1},
            "added_mass_coupling": {"Y_rdot": {"value": coupling, "estimate": True}},
            "linear_damping": {n: free[n] for n in ("Y_v", "N_r")},
            "linear_damping_coupling": {n: free[n] for n in ("Y_r", "N_v")},
        },
    }
    return vehicle_from_table(VehicleTable.model_validate(table), catalogue())


def driven(vehicle: Vehicle, sigma: float = 1e-3, seed: int = 0) -> Run:
    """A simulated log of 60 s at 10 Hz with forces that jump every two seconds."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 60.0, 0.1)
    force = np.repeat(rng.uniform(-6, 6, (30, 2)), 20, axis=0) * [1.0, 0.3]
    functions = Functions(vehicle)
    states = Simulator(functions, compiled=False).run(np.zeros(4), t, force, np.array(functions.values()))
    noisy = states[:, 2:] + sigma * rng.standard_normal((len(t), 2))
    return Run("two", t, {"v": noisy[:, 0], "r": noisy[:, 1], "tau_Y": force[:, 0], "tau_N": force[:, 1]})


def _mass(functions: Functions) -> np.ndarray:
    return np.asarray(
        ca.Function("m", [functions.p], [ca.densify(functions.mass_matrix)])(functions.values())
    )


@pytest.mark.parametrize("size", [1e200, np.inf, np.nan])
def test_along_what_grows_without_bound_there_is_no_step(size: float) -> None:
    model = WeakModel(Functions(sway_yaw(10.0, 2.0, 0.5)), ("Y_rdot", "Y_v", "N_r"))
    J = np.random.default_rng(3).standard_normal((40, 3))
    J[7, 1] = size  # squared, beyond the largest number
    at = Linearised(np.ones(40), J, np.zeros((40, 0)))
    with np.errstate(over="ignore", invalid="ignore"):
        step = limited_step(model, at, np.array(model.functions.values()), bounds_of(model), NOTHING)
    assert np.isfinite(step).all()
    assert step[1] == 0.0


# --- the mass matrix --------------------------------------------------------------------------------------


def test_the_step_is_the_solution_under_the_matrix_inequality() -> None:
    """Against a general solver with the least eigenvalue as its constraint."""
    vehicle = sway_yaw(10.0, 2.0, 0.5)
    model = WeakModel(Functions(vehicle), ("Y_rdot", "Y_v", "N_r"))
    p = np.array(model.functions.values())
    rng = np.random.default_rng(3)
    J = rng.standard_normal((40, 3))
    wanted = np.array([-9.0, 1.0, -0.5])
    at = Linearised(-J @ wanted, J, np.zeros((40, 0)))
    step = limited_step(model, at, p, bounds_of(model), NOTHING)
    scale = np.diag(1.0 / np.sqrt(np.diag(_mass(model.functions))))

    def least(move: np.ndarray) -> float:
        coupling = -(0.5 + move[0])
        return float(np.linalg.eigvalsh(scale @ np.array([[11.0, coupling], [coupling, 2.1]]) @ scale)[0])

    inside = NonlinearConstraint(least, 1e-3, np.inf)
    bounds = [(a - p[k], b - p[k]) for k, a, b in zip(model.places, *bounds_of(model), strict=True)]
    found = minimize(
        lambda s: float(np.sum((at.r + J @ s) ** 2)),
        np.zeros(3),
        constraints=[inside],
        bounds=bounds,
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    np.testing.assert_allclose(step, found.x, atol=2e-5)
    assert least(step) == pytest.approx(1e-3, abs=1e-6)


def test_a_search_does_not_end_beyond_a_singular_mass_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    """From a coupling of 6 kg m, more than 10 kg and 2 kg m^2 can have, to the true one."""
    stated = sway_yaw(10.0, 2.0, 0.0)
    data = prepare([driven(sway_yaw(10.0, 2.0, -2.0))], stated)
    inside = fit_weak(stated, data, start={"Y_rdot": -6.0})
    assert inside.values["Y_rdot"] == pytest.approx(-2.0, abs=0.02)
    assert inside.active == []
    monkeypatch.setattr(JointLimits, "cuts", lambda self, p: [])
    monkeypatch.setattr(JointLimits, "violated", lambda self, p: False)
    beyond = fit_weak(stated, data, start={"Y_rdot": -6.0})
    assert np.linalg.eigvalsh(_mass(Functions(beyond.vehicle)))[0] < 0


def test_output_error_ends_where_it_is_physical() -> None:
    stated = sway_yaw(10.0, 2.0, 0.0)
    fit = fit_output_error(stated, [driven(sway_yaw(10.0, 2.0, -2.0))], start={"Y_rdot": 1.0})
    assert fit.values["Y_rdot"] == pytest.approx(-2.0, abs=0.02)


def test_a_start_that_is_not_physical_is_moved_to_the_nearest_that_is() -> None:
    vehicle = sway_yaw(10.0, 2.0, 0.5)
    model = WeakModel(Functions(vehicle), ("Y_rdot",))
    p = np.array(model.functions.values())
    k = model.places[0]
    p[k] = -20.0
    moved = nearest_physical(model, p, bounds_of(model))
    assert moved[k] == pytest.approx(-np.sqrt(11.0 * 2.1), rel=2e-3)
    assert np.array_equal(np.delete(moved, k), np.delete(p, k))
    assert model.limits.violated(p)
    assert not model.limits.violated(moved)


def test_where_nothing_is_violated_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    case = make_case("usv", (), 4, duration=30.0, runs=("steps",))
    model, runs = with_effect(vehicle_of(case), "added_mass_coupling", Y_rdot=0.0), runs_of(case)
    guarded = fit_weak(model, prepare(runs, model))
    monkeypatch.setattr(JointLimits, "cuts", lambda self, p: [])
    monkeypatch.setattr(JointLimits, "violated", lambda self, p: False)
    plain = fit_weak(model, prepare(runs, model))
    assert np.array_equal(guarded.p, plain.p)
    assert not any("mass" in line for line in guarded.active)


def test_six_motions_are_looked_at_together() -> None:
    """Three couplings that are fine pair by pair, but not all at once."""
    names = ("surge", "sway", "heave", "roll", "pitch", "yaw")
    effects = {
        "rigid_body": {"m": 1.0, "I_x": 1.0, "I_y": 1.0, "I_z": 1.0},
        "added_mass_coupling": {n: {"value": 0.0, "estimate": True} for n in ("X_vdot", "X_wdot", "Y_wdot")},
    }
    table = {
        "schema": "undertow/vehicle/1",
        "name": "six",
        "signs": "sname",
        "degrees_of_freedom": list(names),
        "effects": effects,
    }
    table |= {"generalised_forces": ["tau_X"]}
    model = WeakModel(
        Functions(vehicle_from_table(VehicleTable.model_validate(table), catalogue())),
        ("X_vdot", "X_wdot", "Y_wdot"),
    )
    p = np.array(model.functions.values())
    at = Linearised(-0.8 * np.ones(3), np.eye(3), np.zeros((3, 0)))
    step = limited_step(model, at, p, bounds_of(model), NOTHING)
    # M = 1 - c for all three: eigenvalues 1 + c (twice) and 1 - 2 c; pair by pair c = 0.8 would do.
    np.testing.assert_allclose(step, (1 - 1e-3) / 2, atol=1e-5)


# --- the inertia of slow motion ---------------------------------------------------------------------------
def _slow_inertia(vehicle: Vehicle) -> float:
    """Force over acceleration in surge at one cycle in 1000 s, of the linearised equations of motion."""
    f = Functions(vehicle)
    rates = ca.Function("rates", [f.x, f.u, f.p, f.t], [ca.jacobian(f.x_dot, f.x), ca.jacobian(f.x_dot, f.u)])
    nothing = np.zeros(f.x.numel()), np.zeros(f.u.numel()), np.array(f.values()), 0.0
    A, B = (np.asarray(each.full()) for each in rates(*nothing))
    omega = 2e-3 * np.pi
    response = np.linalg.solve(1j * omega * np.eye(len(A)) - A, B[:, 0])
    return float((1.0 / response[f.state_names.index("u")]).imag / omega)


def _surge_with(effect: str, **values: float) -> Vehicle:
    table = {
        "schema": "undertow/vehicle/1",
        "name": "one",
        "degrees_of_freedom": ["surge"],
        "signs": "sname",
        "generalised_forces": ["tau_X"],
        "effects": {
            "rigid_body": {"m": 10.0},
            "added_mass": {"X_udot": {"value": -2.0, "estimate": True}},
            "linear_damping": {"X_u": -4.0},
            effect: {n: {"value": v, "estimate": True} for n, v in values.items()},
        },
    }
    return vehicle_from_table(VehicleTable.model_validate(table), catalogue())


@pytest.mark.parametrize(
    ("effect", "values", "added"),
    [
        ("radiation_memory", {"X_memu": -3.0, "T_memory": 0.5}, 2.0 - 3.0 * 0.5**2),
        ("radiation_memory", {"X_memu": 1.5, "T_memory": 0.8}, 2.0 + 1.5 * 0.8**2),
        ("radiation_memory", {"X_memu": -3.0, "T_memory": 2.0}, 2.0 - 3.0 * 2.0**2),
        ("slosh", {"m_slosh": 3.0, "slosh_frequency": 2.0, "slosh_damping": 0.1}, 2.0 + 3.0),
    ],
)
def test_the_added_mass_of_slow_motion(effect: str, values: dict[str, float], added: float) -> None:
    """What is left of the added mass at frequency zero is that of the linearised equations of motion."""
    vehicle = _surge_with(effect, **values)
    assert _slow_inertia(vehicle) == pytest.approx(10.0 + added, rel=1e-3, abs=1e-2)
    functions = Functions(vehicle)
    slow = added_mass_at_zero_frequency(functions, np.array(functions.values()))
    assert slow == pytest.approx(np.array([[added]]))


# --- damping ----------------------------------------------------------------------------------------------


def test_damping_takes_energy_where_that_is_asked_for() -> None:
    truth = sway_yaw(10.0, 2.0, 0.5, Y_r=9.0, N_v=-0.5)
    run, stated = driven(truth), sway_yaw(10.0, 2.0, 0.5)
    data = prepare([run], stated)
    free, held = fit_weak(stated, data), fit_weak(stated, data, constraints=Constraints(dissipative=True))
    assert free.values["Y_r"] == pytest.approx(9.0, abs=0.3)
    D = -np.array([[held.values["Y_v"], held.values["Y_r"]], [held.values["N_v"], held.values["N_r"]]])
    assert np.linalg.eigvalsh(D + D.T)[0] == pytest.approx(0.0, abs=1e-3)
    assert np.linalg.eigvalsh(D + D.T)[0] > -1e-5
    assert any("D + D' >= 0" in line for line in held.active)
    left = [np.nansum(noise_ratio(fit, data)) for fit in (held, free)]
    assert left[0] > left[1]


# --- equality ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", first_quick(["weak", "output error"]))
def test_an_equality_holds_exactly_and_lowers_the_error(method: str) -> None:
    case = make_case("usv", (), 4, duration=30.0, runs=("steps",))
    vehicle, runs = vehicle_of(case), runs_of(case)

    def fit(constraints: Constraints):
        if method == "weak":
            return fit_weak(vehicle, prepare(runs, vehicle), constraints=constraints)
        return fit_output_error(vehicle, runs, constraints=constraints)

    plain = fit(Constraints())
    ratio = plain.values["Y_vdot"] / plain.values["X_udot"]
    tied = fit(Constraints(equal={"Y_vdot": ("X_udot", ratio)}))
    assert "Y_vdot" not in tied.values
    value = tied.vehicle.value_of
    assert value("Y_vdot").value == pytest.approx(ratio * value("X_udot").value, rel=1e-14)
    assert value("Y_vdot").sigma == pytest.approx(ratio * value("X_udot").sigma, rel=1e-14)
    # The ratio is that of the free fit, so the optimum is the same; what two tell of one number is more.
    assert tied.values["X_udot"] == pytest.approx(
        plain.values["X_udot"], abs=0.2 * plain.standard_errors["X_udot"]
    )
    assert tied.standard_errors["X_udot"] < 0.999 * plain.standard_errors["X_udot"]
    assert set(verdicts(tied)) == set(tied.values)


def test_the_information_of_tied_parameters_is_that_of_their_sum() -> None:
    case = make_case("usv", (), 4, duration=30.0, runs=("steps",))
    vehicle = vehicle_of(case)
    data = prepare(runs_of(case), vehicle)
    tied = fit_weak(vehicle, data, constraints=Constraints(equal={"Y_v": ("X_u", 2.0)}))
    free = (*tied.model.free, "Y_v")
    start = tied.values | {"Y_v": 2 * tied.values["X_u"]}
    model, noise = WeakModel(Functions(vehicle), free), (tied.whitening, tied.disturbance)
    whole = fit_under_noise(model, data, start, *noise, steps=0)
    across = np.eye(len(free))[:, :-1]
    across[-1, tied.model.free.index("X_u")] = 2.0
    np.testing.assert_allclose(tied.gram, across.T @ whole.gram @ across, rtol=1e-6, atol=1e-6)


def test_equalities_are_read_in_the_signs_of_the_file() -> None:
    vehicle = surge_vehicle()
    assert read_equalities(["X_u = 0.5 X_uabsu"], vehicle) == {"X_u": ("X_uabsu", 0.5)}
    assert read_equalities(["X_u=2*X_uabsu"], vehicle) == {"X_u": ("X_uabsu", 2.0)}
    assert read_equalities(["m = X_udot"], vehicle) == {"m": ("X_udot", -1.0)}
    for text, said in (
        ("X_u", "is not an equality"),
        ("X_u = Y_v", "'Y_v' is not a parameter in the equations of 'surge'"),
        ("X_u = 1.2.3 X_uabsu", "is not a number"),
        ("X_u = 1e999 X_uabsu", "the factor is inf"),
        ("X_u = -1e999 X_uabsu", "the factor is -inf"),
        ("X_u = 0 X_uabsu", "the factor is 0"),
    ):
        with pytest.raises(UndertowError, match=said):
            read_equalities([text], vehicle)
    run = surge_run(0.02)
    for equal in ({"X_u": ("X_u", 1.0)}, {"X_u": ("X_udot", 0.0)}, {"X_u": ("X_udot", np.inf)}):
        with pytest.raises(UndertowError, match="to itself or to nothing"):
            fit_output_error(vehicle, [run], constraints=Constraints(equal=equal))
    with pytest.raises(UndertowError, match="no physical value for both"):
        fit_output_error(vehicle, [run], constraints=Constraints(equal={"X_u": ("X_uabsu", -1.0)}))


def test_what_follows_a_known_parameter_stays_physical() -> None:
    """m is known: added mass of the wrong sign, and a coupling that makes the mass matrix negative."""
    surge, two = surge_vehicle(), sway_yaw(10.0, 2.0, 0.5)
    wrong_sign, negative = (Constraints(equal=e) for e in ({"X_udot": ("m", 1.5)}, {"Y_rdot": ("m", 1.0)}))
    run = surge_run(0.02)
    with pytest.raises(UndertowError, match=r"X_udot = 1.5 m makes X_udot .* must lie between"):
        fit_weak(surge, prepare([run], surge), constraints=wrong_sign)
    with pytest.raises(UndertowError, match=r"X_udot = 1.5 m makes X_udot .* must lie between"):
        fit_output_error(surge, [run], constraints=wrong_sign)
    with pytest.raises(UndertowError, match=r"Y_rdot = 1 m .* leaves no mass matrix M > 0"):
        negative.model(two, ("Y_rdot", "Y_v", "N_r"))


def test_what_follows_a_known_parameter_may_be_physical() -> None:
    vehicle = sway_yaw(10.0, 2.0, 0.5)
    model = Constraints(equal={"Y_rdot": ("m", 0.2)}).model(vehicle, ("Y_rdot", "Y_v", "N_r"))
    assert model.free == ("Y_v", "N_r")
    model = Constraints(equal={"Y_v": ("Y_vdot", 3.0)}).model(vehicle, ("Y_v", "N_r"))
    assert model.free == ("N_r",)


def test_priors_of_tied_parameters_count_in_their_own_units() -> None:
    stated = surge_vehicle()
    first, second = (replace(stated.value_of(n), value=v, sigma=s) for n, v, s in
                     (("X_u", -0.3, 0.1), ("X_uabsu", -4.0, 0.4)))  # fmt: skip
    vehicle = stated.with_values({"X_u": first, "X_uabsu": second})
    model = Constraints(equal={"X_uabsu": ("X_u", 10.0)}).model(vehicle, ("X_udot", "X_u", "X_uabsu"))
    centre, weight = prior_of(model)
    # 0.4 of X_uabsu is 0.04 of X_u; five standard deviations wide, as every prior.
    total = (1 / 0.5) ** 2 + (1 / 0.2) ** 2
    assert weight[1] == pytest.approx(np.sqrt(total))
    assert centre[1] == pytest.approx(-(0.3 / 0.5**2 + 0.4 / 0.2**2) / total)


def test_a_guessed_mass_is_found_by_the_weight_it_has() -> None:
    """A float whose mass is a guess, 2.5% too large: 7.5 N of weight that is not there.

    Truth of the simulator: 30 kg, which its buoyancy of 294.3 N holds.
    """
    made = make_case("float", (), 77991989)
    body = made.vehicle["effects"]["rigid_body"]
    body["m"] = {"value": 1.025 * body["m"], "estimate": True, "sigma": 0.05 * body["m"]}
    vehicle = vehicle_of(made)
    fit = fit_weak(vehicle, prepare(runs_of(made)[:-1], vehicle))
    assert fit.vehicle.values["m"].value == pytest.approx(30.0, rel=1e-4)
    assert fit.vehicle.values["W"].value == pytest.approx(294.3, rel=1e-4)
    assert not fit.vehicle.values["W"].estimate
