"""The symbols used by every effect: SNAME motions and forces, signals of the residual form, kinematics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import sqrt

import sympy as sm

DOFS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
POSE = ("x", "y", "z", "phi", "theta", "psi")
VELOCITY = ("u", "v", "w", "p", "q", "r")
FORCE = ("X", "Y", "Z", "K", "M", "N")
FORCE_UNITS = ("N",) * 3 + ("N m",) * 3
POSE_UNITS = ("m",) * 3 + ("rad",) * 3
VELOCITY_UNITS = ("m/s",) * 3 + ("rad/s",) * 3
MOTION_UNITS = dict(zip((*POSE, *VELOCITY), (*POSE_UNITS, *VELOCITY_UNITS), strict=True))
# Columns of a log that mean the same for every vehicle: nothing of a vehicle's own may be called so.
CHANNELS = frozenset({"t", *POSE, *VELOCITY, *(f"{v}_dot" for v in VELOCITY), *(f"tau_{f}" for f in FORCE)})
# No vehicle in water moves or turns faster, and no water flows faster: m/s and rad/s.
FASTEST = 100.0


@dataclass(frozen=True)
class EnvironmentSettings:
    """Water and gravity where none are stated."""

    density: float = 1000.0  # of water, fresh, kg/m^3
    gravity: float = 9.81  # m/s^2


ENVIRONMENT = EnvironmentSettings()


def symbol(name: str) -> sm.Symbol:
    """Real symbol called `name`; the same name is always the same symbol."""
    return sm.Symbol(name, real=True)


def column(names: tuple[str, ...] | list[str]) -> sm.Matrix:
    """Column of real symbols, shape (len(names), 1)."""
    return sm.Matrix(len(names), 1, [symbol(n) for n in names])


def spelled_out(meanings: Iterable[Mapping[sm.Symbol, sm.Expr]]) -> dict[sm.Symbol, sm.Expr]:
    """Meanings of symbols, fully expanded; a later group may use the symbols of earlier ones."""
    known: dict[sm.Symbol, sm.Expr] = {}
    for group in meanings:
        known |= {name: meaning.xreplace(known) for name, meaning in group.items()}
    return known


@dataclass(frozen=True)
class Signals:
    """What an effect may use to state its physics (body frame, SI).

    Attributes
    ----------
    eta, nu, nu_dot : Matrix, shape (6, 1)
        Pose (NED, Euler angles), body velocity over ground, and its rate.
    nu_r, nu_r_dot : Matrix, shape (6, 1)
        Velocity through the water and its rate; equal to `nu` and `nu_dot` where no flow effect is present.
    actuation : Matrix, shape (n_thrusters, 1)
        What reaches each thruster after all actuation effects, in units of its command.
    deflection : Matrix, shape (n_surfaces, 1)
        Angle of each control surface after all actuation effects, rad.
    generalised_force : Matrix, shape (6, 1)
        Forces and moments that the log itself holds (channels tau_X ... tau_N), N and N m.
    t : Symbol
        Time since the start of the run, s.
    rho, g : Symbol
        Density of the water, kg/m^3, and gravity, m/s^2.
    """

    eta: sm.Matrix
    nu: sm.Matrix
    nu_dot: sm.Matrix
    nu_r: sm.Matrix
    nu_r_dot: sm.Matrix
    actuation: sm.Matrix
    deflection: sm.Matrix
    generalised_force: sm.Matrix
    t: sm.Symbol
    rho: sm.Symbol
    g: sm.Symbol


@cache
def signals(thrusters: tuple[str, ...] = (), surfaces: tuple[str, ...] = ()) -> Signals:
    """Signals of a vehicle with these thrusters and control surfaces."""
    angular = list(VELOCITY[3:])
    angular_rate = [f"{n}_dot" for n in angular]
    return Signals(
        eta=column(POSE),
        nu=column(VELOCITY),
        nu_dot=column([f"{n}_dot" for n in VELOCITY]),
        # The water does not rotate, so only the translations have a relative velocity of their own.
        nu_r=column(["u_r", "v_r", "w_r", *angular]),
        nu_r_dot=column(["u_r_dot", "v_r_dot", "w_r_dot", *angular_rate]),
        actuation=column([f"actuation_{n}" for n in thrusters]),
        deflection=column([f"deflection_{n}" for n in surfaces]),
        generalised_force=column([f"tau_{n}" for n in FORCE]),
        t=symbol("t"),
        rho=symbol("rho"),
        g=symbol("g"),
    )


def signal_units(s: Signals) -> dict[sm.Symbol, str]:
    """Unit of every signal symbol, for dimensional analysis."""
    rate = ("m/s^2",) * 3 + ("rad/s^2",) * 3
    units: dict[sm.Symbol, str] = {s.t: "s", s.rho: "kg/m^3", s.g: "m/s^2"}
    for matrix, names in (
        (s.eta, POSE_UNITS),
        (s.nu, VELOCITY_UNITS),
        (s.nu_dot, rate),
        (s.nu_r, VELOCITY_UNITS),
        (s.nu_r_dot, rate),
        (s.generalised_force, FORCE_UNITS),
        (s.actuation, ("command",) * s.actuation.rows),
        (s.deflection, ("rad",) * s.deflection.rows),
    ):
        units.update(zip(matrix, names, strict=True))
    return units


# --- rotations and Euler-angle kinematics (roll-pitch-yaw, NED to FRD) ----------------------------
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
