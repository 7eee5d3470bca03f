"""Rotations and Euler-angle kinematics (roll-pitch-yaw, NED to FRD)."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import sympy as sm


def skew(a: sm.Matrix) -> sm.Matrix:
    """Matrix S(a) with S(a) b = a x b, shape (3, 3)."""
    return sm.Matrix([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def rotation(angles: sm.Matrix) -> sm.Matrix:
    """Rotation R from body to NED axes for (phi, theta, psi) in rad, shape (3, 3).

    Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, chapter 2 (zyx order).
    """
    phi, theta, psi = angles
    return sm.rot_ccw_axis3(psi) * sm.rot_ccw_axis2(theta) * sm.rot_ccw_axis1(phi)


def body_rates(angles: sm.Matrix) -> sm.Matrix:
    """The matrix W with (p, q, r) = W d(phi, theta, psi)/dt, shape (3, 3); (6) of the mini-AUV paper."""
    phi, theta, _ = angles
    return sm.Matrix(
        [
            [1, 0, -sm.sin(theta)],
            [0, sm.cos(phi), sm.sin(phi) * sm.cos(theta)],
            [0, -sm.sin(phi), sm.cos(phi) * sm.cos(theta)],
        ]
    )


def euler_rates(angles: sm.Matrix) -> sm.Matrix:
    """The matrix T = inverse of W with d(phi, theta, psi)/dt = T (p, q, r), shape (3, 3).

    Singular at theta = +-90 degrees, like every Euler-angle description.
    """
    phi, theta, _ = angles
    tan, cos = sm.tan(theta), sm.cos(theta)
    return sm.Matrix(
        [
            [1, sm.sin(phi) * tan, sm.cos(phi) * tan],
            [0, sm.cos(phi), -sm.sin(phi)],
            [0, sm.sin(phi) / cos, sm.cos(phi) / cos],
        ]
    )


def pose_jacobian(eta: sm.Matrix) -> sm.Matrix:
    """The matrix J with d(eta)/dt = J(eta) nu, shape (6, 6)."""
    angles = sm.Matrix(eta[3:])
    return sm.diag(rotation(angles), euler_rates(angles))


def inertia_tensor(
    moments: tuple[sm.Expr, sm.Expr, sm.Expr], products: tuple[sm.Expr, sm.Expr, sm.Expr]
) -> sm.Matrix:
    """Inertia tensor from (I_x, I_y, I_z) and the products of inertia (I_xy, I_xz, I_yz), shape (3, 3)."""
    xy, xz, yz = products
    return sm.diag(*moments) - sm.Matrix([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])


def inertia_matrix(mass: sm.Expr, moments: sm.Matrix, tensor: sm.Matrix) -> sm.Matrix:
    """Inertia matrix of a body about the origin from its base parameters, shape (6, 6).

    `mass`: mass, kg; `moments` (3, 1): static moments, mass times place of the centre of gravity, kg m;
    `tensor` (3, 3): inertia tensor about the origin, kg m^2.
    """
    arm = skew(moments)
    upper = sm.Matrix.hstack(mass * sm.eye(3), -arm)
    return sm.Matrix.vstack(upper, sm.Matrix.hstack(arm, tensor))


def coriolis(inertia: sm.Matrix, nu: sm.Matrix) -> sm.Matrix:
    """Skew-symmetric Coriolis and centripetal matrix C(nu) of a constant symmetric inertia, shape (6, 6).

    Follows from Kirchhoff's equations for the kinetic energy nu' M nu / 2; Fossen (2021), chapters 3 and 6.
    """
    momentum = inertia * nu
    linear, angular = sm.Matrix(momentum[:3]), sm.Matrix(momentum[3:])
    upper = sm.Matrix.hstack(sm.zeros(3), -skew(linear))
    lower = sm.Matrix.hstack(-skew(linear), -skew(angular))
    return sm.Matrix.vstack(upper, lower)


def failing_pivot(rows: Sequence[Sequence[float]], shift: float = 0.0) -> int | None:
    """Row at which Cholesky's factorisation of a symmetric matrix, plus `shift` on its diagonal, fails."""
    factor = [[0.0] * len(rows) for _ in rows]
    for i in range(len(rows)):
        for j in range(i + 1):
            rest = rows[i][j] + shift * (i == j) - sum(factor[i][k] * factor[j][k] for k in range(j))
            if i == j and not rest > 0:
                return i
            factor[i][j] = sqrt(rest) if i == j else rest / factor[j][j]
    return None
