"""The symbols every effect speaks in: SNAME motions, forces, and the signals of the residual form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

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


def symbol(name: str) -> sm.Symbol:
    """Real symbol called `name`; the same name is always the same symbol."""
    return sm.Symbol(name, real=True)


def column(names: tuple[str, ...] | list[str]) -> sm.Matrix:
    """Column of real symbols, shape (len(names), 1)."""
    return sm.Matrix(len(names), 1, [symbol(n) for n in names])


def spelled_out(meanings: Iterable[Mapping[sm.Symbol, sm.Expr]]) -> dict[sm.Symbol, sm.Expr]:
    """Meanings of symbols, of which a later group may use the symbols of earlier ones, in terms of none."""
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
