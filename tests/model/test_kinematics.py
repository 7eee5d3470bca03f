"""Euler angles and Coriolis matrices: identities proved symbolically, and bodies whose motion is known."""

from __future__ import annotations

import math
from random import Random

import pytest
import sympy as sm

from undertow.model.symbols import body_rates, column, coriolis, euler_rates, pose_jacobian, rotation, skew

ANGLES = column(["phi", "theta", "psi"])
OMEGA = column(["p", "q", "r"])
A, B = column(["a1", "a2", "a3"]), column(["b1", "b2", "b3"])


_PAIRS = [(sm.Symbol(f"s_{a}"), sm.Symbol(f"c_{a}")) for a in ANGLES]
_SINES = {f(a): g for a, (s, c) in zip(ANGLES, _PAIRS, strict=True) for f, g in ((sm.sin, s), (sm.cos, c))}
_TAN = {sm.tan(a): sm.sin(a) / sm.cos(a) for a in ANGLES}


def assert_zero(matrix: sm.Matrix) -> None:
    """Prove an identity in the angles: modulo sin^2 + cos^2 = 1 its numerator is the zero polynomial."""
    for entry in sm.Matrix([matrix]):
        numerator = sm.fraction(sm.together(entry.subs(_TAN).subs(_SINES)))[0]
        for s, c in _PAIRS:
            numerator = sm.rem(sm.expand(numerator), s**2 + c**2 - 1, s)
        assert numerator == 0, entry


def test_skew_is_the_cross_product() -> None:
    assert skew(A) * B == A.cross(B)
    assert -skew(A) == skew(A).T


def test_rotation_is_orthogonal_and_proper() -> None:
    turn = rotation(ANGLES)
    assert_zero(turn.T * turn - sm.eye(3))
    assert_zero(sm.Matrix([turn.det(method="berkowitz") - 1]))


@pytest.mark.parametrize(
    ("angles", "body", "ned"),
    [
        ((0, 0, sm.pi / 2), (1, 0, 0), (0, 1, 0)),  # heading east, ahead is east
        ((0, sm.pi / 2, 0), (1, 0, 0), (0, 0, -1)),  # nose up, ahead is up
        ((sm.pi / 2, 0, 0), (0, 1, 0), (0, 0, 1)),  # rolled to starboard, starboard is down
        ((0, sm.pi / 6, 0), (1, 0, 0), (sm.sqrt(3) / 2, 0, -sm.Rational(1, 2))),
        ((0, 0, sm.pi), (0, 1, 0), (0, -1, 0)),  # heading south, starboard is west
    ],
)
def test_rotation_turns_from_body_to_north_east_down(angles: tuple, body: tuple, ned: tuple) -> None:
    assert rotation(sm.Matrix(angles)) * sm.Matrix(body) == sm.Matrix(ned)


def test_order_of_the_angles_is_yaw_then_pitch_then_roll() -> None:
    phi, theta, psi = ANGLES
    parts = [rotation(sm.Matrix(a)) for a in ((0, 0, psi), (0, theta, 0), (phi, 0, 0))]
    assert_zero(rotation(ANGLES) - parts[0] * parts[1] * parts[2])


def test_t_is_the_inverse_of_w() -> None:
    assert_zero(euler_rates(ANGLES) * body_rates(ANGLES) - sm.eye(3))


def test_rotation_changes_with_the_body_rates() -> None:
    """d/dt R = R S(omega), with the Euler angles moving at T omega."""
    turn, angle_rates = rotation(ANGLES), euler_rates(ANGLES) * OMEGA
    rate = sum((turn.diff(a) * da for a, da in zip(ANGLES, angle_rates, strict=True)), sm.zeros(3))
    assert_zero(rate - turn * skew(OMEGA))


def test_pose_jacobian_stacks_r_and_t() -> None:
    eta = column(["x", "y", "z", "phi", "theta", "psi"])
    jacobian = pose_jacobian(eta)
    assert jacobian[:3, :3] == rotation(ANGLES)
    assert jacobian[3:, 3:] == euler_rates(ANGLES)
    assert jacobian[:3, 3:].is_zero_matrix
    assert jacobian[3:, :3].is_zero_matrix


def test_yaw_alone_is_the_planar_case() -> None:
    level = {ANGLES[0]: 0, ANGLES[1]: 0}
    psi = ANGLES[2]
    planar = sm.Matrix([[sm.cos(psi), -sm.sin(psi), 0], [sm.sin(psi), sm.cos(psi), 0], [0, 0, 1]])
    assert rotation(ANGLES).subs(level) == planar
    assert euler_rates(ANGLES).subs(level) == sm.eye(3)


# --- Coriolis ---------------------------------------------------------------------------------------
NU = column(["u", "v", "w", "p", "q", "r"])
INERTIA = sm.Matrix(6, 6, lambda i, j: sm.Symbol(f"m{min(i, j)}{max(i, j)}", real=True))


def test_coriolis_matrix_is_skew_symmetric_for_any_symmetric_inertia() -> None:
    matrix = coriolis(INERTIA, NU)
    assert (matrix + matrix.T).expand().is_zero_matrix
    assert sm.expand((NU.T * matrix * NU)[0]) == 0


def test_m_dot_minus_2_c_is_skew_in_inertial_coordinates_too() -> None:
    """With M_eta = J^-T M J^-1 the matrix d(M_eta)/dt - 2 C_eta stays skew-symmetric (seeded numbers)."""
    draw = Random(3)
    root = sm.Matrix(6, 6, lambda *_: draw.uniform(-1, 1))
    mass = root * root.T
    eta = column(["x", "y", "z", "phi", "theta", "psi"])
    point = {a: draw.uniform(-1.2, 1.2) for a in eta[3:]}
    velocity = sm.Matrix([draw.uniform(-1, 1) for _ in range(6)])
    jacobian = pose_jacobian(eta)
    at = jacobian.subs(point)
    eta_dot = at * velocity
    rate = sum((jacobian.diff(a) * d for a, d in zip(eta[3:], eta_dot[3:], strict=True)), sm.zeros(6))
    inverse = at.inv()
    inverse_rate = -inverse * rate.subs(point) * inverse
    mass_rate = inverse_rate.T * mass * inverse + inverse.T * mass * inverse_rate
    coriolis_eta = inverse.T * (coriolis(mass, velocity) * inverse + mass * inverse_rate)
    left = mass_rate - 2 * coriolis_eta
    assert max(abs(x) for x in left + left.T) < 1e-12


def test_coriolis_of_a_point_mass_is_its_acceleration() -> None:
    """A particle at r in the body: force m d/dt(v + omega x r) as seen in turning axes."""
    m, omega, r = sm.Symbol("m"), sm.Matrix(NU[3:]), column(["rx", "ry", "rz"])
    inertia = m * sm.Matrix.vstack(
        sm.Matrix.hstack(sm.eye(3), -skew(r)), sm.Matrix.hstack(skew(r), -skew(r) * skew(r))
    )
    velocity = sm.Matrix(NU[:3]) + omega.cross(r)
    force = m * omega.cross(velocity)  # the part without accelerations
    found = coriolis(inertia, NU) * NU
    assert (sm.Matrix(found[:3]) - force).expand().is_zero_matrix
    assert (sm.Matrix(found[3:]) - r.cross(force)).expand().is_zero_matrix


def test_torque_free_symmetric_top_precesses() -> None:
    """Euler's equations: p and q turn at (I_z - I_x) r / I_x."""
    i_x, i_z = sm.symbols("I_x I_z")
    spin = column(["zero"] * 3 + ["p", "q", "r"]).subs({sm.Symbol("zero", real=True): 0})
    moment = -(coriolis(sm.diag(0, 0, 0, i_x, i_x, i_z), spin) * spin)
    p, q, r = spin[3:]
    expected = [(i_x - i_z) * q * r, (i_z - i_x) * p * r, 0]
    assert (sm.Matrix(moment[3:]) - sm.Matrix(expected)).expand().is_zero_matrix


def test_constant_turn_needs_the_centripetal_force() -> None:
    m, u, r = 7.0, 2.0, 0.3
    nu = sm.Matrix([u, 0, 0, 0, 0, r])
    force = coriolis(sm.diag(m, m, m, 0, 0, 0), nu) * nu
    assert math.isclose(float(force[1]), m * u * r)
    assert [float(f) for i, f in enumerate(force) if i != 1] == [0, 0, 0, 0, 0]
