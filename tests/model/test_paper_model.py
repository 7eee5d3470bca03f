"""The mini-AUV paper's model, (4) to (15), against what follows from the effects.

The right-hand sides below are the paper's matrices, typed in as printed (hydrodynamic coefficients are
positive magnitudes, z is down). The left-hand sides are never typed in: wrenches come from the effects, the
inertial form from the Jacobian of the kinematics. The paper is "Mini-AUV Hydrodynamic Parameters
Identification via CFD Simulations and Their Application on Control Performance Evaluation" (2021, CC BY).
"""

from __future__ import annotations

from functools import cache

import pytest
import sympy as sm

from undertow.model.catalogue import catalogue
from undertow.model.composition import Composition
from undertow.model.effects.thrusters import Thrusters
from undertow.model.loading import load_vehicle
from undertow.model.symbols import (
    body_rates,
    column,
    euler_rates,
    pose_jacobian,
    rotation,
    signals,
    skew,
    symbol,
)
from undertow.model.vehicle import Vehicle

FOUR = ("surge", "sway", "heave", "yaw")
BODY = ("rigid_body", "added_mass", "linear_damping", "quadratic_damping", "net_buoyancy")
CORIOLIS = ("rigid_body_coriolis", "added_mass_coriolis")

psi, u, v, w, p, q, r = (symbol(n) for n in ("psi", "u", "v", "w", "p", "q", "r"))
m, I_x, I_y, I_z = (symbol(n) for n in ("m", "I_x", "I_y", "I_z"))
ADDED = column(["X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot"])
DAMPING = column(["X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r", "X_uabsu"])
X_ud, Y_vd, Z_wd, _, _, N_rd = ADDED
X_u, Y_v, Z_w, K_p, M_q, N_r, X_uu = DAMPING
B_net = symbol("B_net")

S, C = sm.sin(psi), sm.cos(psi)
J = sm.Matrix([[C, -S, 0, 0], [S, C, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # (15)
M_ADDED = sm.diag(X_ud, Y_vd, Z_wd, N_rd)
M_GAMMA = sm.diag(m, m, m, I_z) + M_ADDED  # (10)
D_GAMMA = sm.diag(X_u + X_uu * sm.Abs(u), Y_v, Z_w, N_r)  # (12)
G_Q = sm.Matrix([0, 0, B_net, 0])  # (13): B - mg is the net buoyancy, upward
# (11) without its factor psi_dot, as printed.
C_PRINTED = sm.Matrix(
    [
        [-S * C * (Y_vd - X_ud), -(S**2 * Y_vd + C**2 * X_ud), 0, 0],
        [C**2 * Y_vd + S**2 * X_ud, S * C * (Y_vd - X_ud), 0, 0],
        [0, 0, 0, 0],
        [0, 0, 0, 0],
    ]
)
Q_DOT = column(["x_dot", "y_dot", "z_dot", "psi_dot"])
Q_DDOT = column(["x_ddot", "y_ddot", "z_ddot", "psi_ddot"])
PSI_DOT = Q_DOT[3]
J_DOT = J.diff(psi) * PSI_DOT


def assert_zero(expression: sm.Expr | sm.Matrix) -> None:
    """Prove an identity in angles: rational in t = tan(angle/2), its numerator expands to nothing."""
    angles = [symbol(n) for n in ("phi", "theta", "psi")]
    half = [symbol(f"t_{a}") for a in angles]
    in_t = {f(a): g for a, t in zip(angles, half, strict=True) for f, g in _half_angle(t)}
    for entry in sm.Matrix([expression]):
        numerator = sm.fraction(sm.together(entry.xreplace(in_t)))[0]
        assert sm.expand(numerator) == 0, f"{entry} is not zero"


def _half_angle(t: sm.Symbol) -> list[tuple[type[sm.Function], sm.Expr]]:
    square = t**2
    return [
        (sm.sin, 2 * t / (1 + square)),
        (sm.cos, (1 - square) / (1 + square)),
        (sm.tan, 2 * t / (1 - square)),
    ]


# The paper: centre of gravity at the origin, principal axes, and one quadratic damping term only.
ABSENT = ("mx_g", "my_g", "mz_g", "I_xy", "I_xz", "I_yz", "Y_vabsv", "Z_wabsw", "N_rabsr")


def as_in_the_paper(residual: sm.Matrix) -> sm.Matrix:
    """Left-hand side of the equation of motion in the paper's positive magnitudes."""
    positive = {a: -a for a in [*ADDED, *DAMPING]}
    return -residual.xreplace(positive | {symbol(n): sm.Integer(0) for n in ABSENT})


@cache
def paper_vehicle(*ids: str, dofs: tuple[str, ...] = FOUR) -> Vehicle:
    effects = tuple(catalogue()[i]() for i in ids)
    return Vehicle("paper", dofs, effects, {})


def left_side(*ids: str) -> sm.Matrix:
    """The equation of motion in body axes, all but the thrust, on the paper's side of the equals sign."""
    return as_in_the_paper(paper_vehicle(*ids).residual)


def kinematic_jacobian(*ids: str) -> sm.Matrix:
    composition = paper_vehicle(*ids).composition
    return composition.pose_rate.jacobian(composition.nu)


def inertial(*ids: str) -> sm.Matrix:
    """The same equation in the inertial frame: motion by q_dot = J gamma, forces by virtual power."""
    composition = paper_vehicle(*ids).composition
    jacobian = kinematic_jacobian(*ids)
    inverse = jacobian.inv().applyfunc(sm.trigsimp)
    gamma = inverse * Q_DOT
    gamma_dot = inverse * Q_DDOT + inverse.diff(psi) * PSI_DOT * Q_DOT
    motion = dict(zip([*composition.nu, *composition.nu_dot], [*gamma, *gamma_dot], strict=True))
    return inverse.T * left_side(*ids).xreplace(motion)


# --- body axes, (9), (10), (12), (13), (15) ---
def test_jacobian_15_is_the_kinematics_of_a_level_vehicle() -> None:
    level = dict.fromkeys((symbol("phi"), symbol("theta")), sm.Integer(0))
    rows = [0, 1, 2, 5]
    from_six = pose_jacobian(signals().eta).xreplace(level).extract(rows, rows)
    assert from_six == J
    assert kinematic_jacobian(*BODY) == J
    assert_zero(J * J.T - sm.eye(4))


def test_mass_matrix_10() -> None:
    assert as_in_the_paper(-paper_vehicle(*BODY).mass_matrix) == M_GAMMA


def test_body_axes_model_9_with_12_and_13_is_the_sum_of_effects_without_coriolis() -> None:
    composition = paper_vehicle(*BODY).composition
    printed = M_GAMMA * composition.nu_dot + D_GAMMA * composition.nu + J.inv() * G_Q
    assert_zero(left_side(*BODY) - printed)


def test_what_9_leaves_out_are_the_coriolis_effects_and_the_munk_moment() -> None:
    dropped = left_side(*BODY, *CORIOLIS) - left_side(*BODY)
    m_11, m_22 = m + X_ud, m + Y_vd
    assert_zero(dropped - sm.Matrix([-m_22 * v * r, m_11 * u * r, 0, (Y_vd - X_ud) * u * v]))


# --- inertial frame, (8), (10), (11), (12), (13) ---
def test_inertial_mass_damping_and_gravity_of_8_follow_by_the_jacobian() -> None:
    side = inertial(*BODY)
    assert_zero(side.jacobian(Q_DDOT) - J * M_GAMMA * J.T)
    at_rest = dict.fromkeys([*Q_DOT, *Q_DDOT], sm.Integer(0))
    assert side.xreplace(at_rest) == G_Q
    gamma = dict(zip([u, v, w, r], J.T * Q_DOT, strict=True))
    damping = inertial("linear_damping", "quadratic_damping")
    assert_zero(damping - (J * D_GAMMA * J.T).xreplace(gamma) * Q_DOT)


def test_coriolis_matrix_that_makes_8_equal_9_is_j_m_jdot_transposed() -> None:
    side = inertial("rigid_body", "added_mass")
    assert_zero(side - J * M_GAMMA * J.T * Q_DDOT - J * M_GAMMA * J_DOT.T * Q_DOT)


def test_printed_11_is_minus_the_added_mass_part() -> None:
    assert_zero(C_PRINTED * PSI_DOT + J * M_ADDED * J_DOT.T)


def test_sign_error_in_11_power_balance() -> None:
    """Energy balances if Mq_dot - 2 Cq is skew-symmetric: printed it is not, with the sign fixed it is."""
    rate = (J * M_GAMMA * J.T).diff(psi) * PSI_DOT
    printed = rate - 2 * C_PRINTED * PSI_DOT
    fixed = rate + 2 * C_PRINTED * PSI_DOT
    assert_zero(fixed + fixed.T)
    in_body_axes = J.T * (printed + printed.T) / 2 * J
    expected = sm.zeros(4)
    expected[0, 1] = expected[1, 0] = 2 * PSI_DOT * (X_ud - Y_vd)
    assert_zero(in_body_axes - expected)


def test_sign_error_in_11_has_a_size() -> None:
    numbers = {X_ud: 1.630825, Y_vd: 2.588308, m: 7.5, PSI_DOT: 1.0, psi: 0.7}
    rate = (J * M_GAMMA * J.T).diff(psi) * PSI_DOT
    printed = rate - 2 * C_PRINTED * PSI_DOT
    body = (J.T * (printed + printed.T) / 2 * J).subs(numbers)
    assert float(body[0, 1]) == pytest.approx(-1.914966, abs=1e-9)
    assert float(body[1, 0]) == pytest.approx(-1.914966, abs=1e-9)
    assert float(body[0, 0]) == pytest.approx(0, abs=1e-12)


def test_second_error_8_with_the_sign_fixed_is_not_9() -> None:
    """The mass is missing from C of (8): in body axes -m v r and +m u r stay, which (9) drops."""
    sign_fixed = J * M_GAMMA * J.T * Q_DDOT - C_PRINTED * PSI_DOT * Q_DOT
    difference = J.T * (sign_fixed - inertial("rigid_body", "added_mass"))
    q_dot = dict(zip(Q_DOT, J * sm.Matrix([u, v, w, r]), strict=True))
    assert_zero(difference.xreplace(q_dot) - sm.Matrix([-m * v * r, m * u * r, 0, 0]))


def test_8_with_the_sign_fixed_is_the_sum_of_effects_with_rigid_body_coriolis_only() -> None:
    side = inertial("rigid_body", "rigid_body_coriolis", "added_mass")
    assert_zero(side - J * M_GAMMA * J.T * Q_DDOT + C_PRINTED * PSI_DOT * Q_DOT)


def test_munk_moment_is_absent_from_8_and_9_and_present_in_the_effects() -> None:
    full = inertial("rigid_body", "rigid_body_coriolis", "added_mass", "added_mass_coriolis")
    q_dot = dict(zip(Q_DOT, J * sm.Matrix([u, v, w, r]), strict=True))
    at_rest = dict.fromkeys(Q_DDOT, sm.Integer(0))
    assert_zero(full[3].xreplace(at_rest).xreplace(q_dot) - (Y_vd - X_ud) * u * v)


# --- six degrees of freedom, (1), (2), (6), (7) ---
ANGLES = column(["phi", "theta", "psi"])
OMEGA = sm.Matrix([p, q, r])
XI_DOT, XI_DDOT = column(["x_dot", "y_dot", "z_dot"]), column(["x_ddot", "y_ddot", "z_ddot"])
SIX = ("surge", "sway", "heave", "roll", "pitch", "yaw")
INERTIA = sm.diag(I_x, I_y, I_z)


def mixed_frame(*ids: str) -> sm.Matrix:
    """Equation of motion as (7) has it: translations in the inertial frame, rotations in body axes."""
    composition = paper_vehicle(*ids, dofs=SIX).composition
    back = rotation(ANGLES).T
    angle_rates = euler_rates(ANGLES) * OMEGA
    back_rate = sum((back.diff(a) * da for a, da in zip(ANGLES, angle_rates, strict=True)), sm.zeros(3))
    velocity, acceleration = back * XI_DOT, back * XI_DDOT + back_rate * XI_DOT
    motion = dict(
        zip([*composition.nu[:3, :], *composition.nu_dot[:3, :]], [*velocity, *acceleration], strict=True)
    )
    side = as_in_the_paper(composition.residual).xreplace(motion)
    return sm.Matrix([*(rotation(ANGLES) * side[:3, :]), *side[3:, :]])


def test_w_of_6_is_the_inverse_of_the_euler_rates() -> None:
    assert_zero(body_rates(ANGLES) * euler_rates(ANGLES) - sm.eye(3))


def test_rotation_of_4_turns_with_the_body_rates() -> None:
    turn = rotation(ANGLES)
    angle_rates = euler_rates(ANGLES) * OMEGA
    rate = sum((turn.diff(a) * da for a, da in zip(ANGLES, angle_rates, strict=True)), sm.zeros(3))
    assert_zero(rate - turn * skew(OMEGA))


def test_rigid_body_1_with_2() -> None:
    """m xi_ddot and I omega_dot + S(omega) I omega: no Coriolis force in the inertial translations."""
    omega_dot = column(["p_dot", "q_dot", "r_dot"])
    printed = sm.Matrix([*(m * XI_DDOT), *(INERTIA * omega_dot + skew(OMEGA) * INERTIA * OMEGA)])
    assert_zero(mixed_frame("rigid_body", "rigid_body_coriolis") - printed)


def test_weight_of_2_acts_downward() -> None:
    printed = sm.Matrix(
        [0, 0, -symbol("W"), 0, 0, 0]
    )  # G_rb = [m g; 0] with g = [0 0 -g], on the left-hand side
    alone = {symbol(n): sm.Integer(0) for n in ("B", "S_x", "S_y", "S_z")}
    assert_zero(mixed_frame("restoring").xreplace(alone) - printed)


def test_added_mass_and_damping_of_7_are_turned_into_the_inertial_frame() -> None:
    turn = sm.diag(rotation(ANGLES), sm.eye(3))
    mass = mixed_frame("added_mass").jacobian([*XI_DDOT, *column(["p_dot", "q_dot", "r_dot"])])
    assert_zero(mass - turn * sm.diag(*ADDED) * turn.T)
    linear = mixed_frame("linear_damping").jacobian([*XI_DOT, *OMEGA])
    printed = sm.diag(X_u, Y_v, Z_w, K_p, M_q, N_r)
    assert_zero(linear - turn * printed * turn.T)


# --- thrusters, (4), (5), (14) ---
def test_thrusters_4_and_5() -> None:
    l_y, l_zd, d = (symbol(n) for n in ("l_y", "l_zd", "d"))
    forward, down = sm.Matrix([1, 0, 0]), sm.Matrix([0, 0, 1])
    places = [(0, -l_y, 0), (0, -l_y, l_zd), (0, l_y, 0), (0, l_y, l_zd)]
    columns = [
        (sm.Matrix(at), along) for at, along in zip(places, (down, forward, down, forward), strict=True)
    ]
    allocation = sm.Matrix.hstack(
        *[sm.Matrix([*along, *(at.cross(along) + d * along)]) for at, along in columns]
    )
    names = ("f1", "f2", "f3", "f4")
    composition = Composition((Thrusters(names).placed(allocation),), tuple(range(6)), names)
    f1, f2, f3, f4 = composition.signals.actuation
    unit = {symbol(f"thrust_{n}"): sm.Integer(1) for n in names}
    force = sm.Matrix([f2 + f4, 0, f1 + f3])
    moment = sm.Matrix([l_y * (f3 - f1) + d * (f2 + f4), l_zd * (f2 + f4), l_y * (f2 - f4) + d * (f1 + f3)])
    assert_zero(composition.residual.xreplace(unit) - sm.Matrix([*force, *moment]))


def test_known_forces_enter_as_in_14() -> None:
    channels = ("tau_X", "tau_Y", "tau_Z", "tau_N")
    vehicle = Vehicle("paper", FOUR, (), {}, force_channels=channels)
    assert vehicle.residual == column(list(channels))
    assert_zero(J.inv() * (J * column(list(channels))) - vehicle.residual)


# --- the bundled vehicle ---
def test_bundled_mini_auv_has_table_4() -> None:
    vehicle = load_vehicle("mini-auv")
    table_4 = {
        "X_udot": (1.630825, 1.932838),
        "X_u": (0.142306, 0.091036),
        "X_uabsu": (5.153776, 5.868182),
        "Z_wdot": (2.588308, 3.908386),
        "Z_w": (7.157339, 7.632676),
    }
    for name, printed in table_4.items():
        values = [-vehicle.value_of(f"{name}_{way}").value for way in ("forward", "backward")]
        assert values == pytest.approx(printed)
    assert -vehicle.value_of("N_rdot").value == 0.0240417
    assert -vehicle.value_of("N_r").value == 0.013791
    assert vehicle.value_of("B_net").value == -14.309872
    assert vehicle.signs == "magnitudes"


def test_bundled_mini_auv_marks_the_sway_values_that_the_paper_does_not_print() -> None:
    vehicle = load_vehicle("mini-auv")
    assumed = {n for n in vehicle.parameter_names if vehicle.value_of(n).assumed}
    assert assumed == {"Y_vdot", "Y_v"}


@pytest.mark.parametrize(("surge", "m_x"), [(0.1, 9.130825), (-0.1, 9.432838)])
def test_bundled_mini_auv_takes_the_set_of_its_direction(surge: float, m_x: float) -> None:
    vehicle = load_vehicle("mini-auv")
    values = {symbol(n): vehicle.value_of(n).value for n in vehicle.parameter_names}
    inertia = vehicle.mass_matrix.subs(values).subs({u: surge})[0, 0]
    assert float(inertia) == pytest.approx(m_x)


def test_bundled_mini_auv_thrusters_are_4_and_5() -> None:
    wrenches = [t.wrench for t in load_vehicle("mini-auv").thrusters]
    assert wrenches == [
        (0, 0, 1, -0.16, 0, 0),
        (1, 0, 0, 0, 0, 0.16),
        (0, 0, 1, 0.16, 0, 0),
        (1, 0, 0, 0, 0, -0.16),
    ]
