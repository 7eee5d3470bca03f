"""The dynamics in two steps: what depends on parameters alone, then the rest with few operations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca

from undertow.model.effect import Flow

from .collecting import Collector
from .momentum import Inertia, find_inertia, is_galilean, kirchhoff
from .solving import solution

if TYPE_CHECKING:
    from .functions import Functions


@dataclass(frozen=True)
class Prepared:
    """The dynamics for many evaluations with the same parameters.

    Attributes
    ----------
    prepare : casadi.Function
        `q = prepare(p)`: coefficients, with the inverse of M where it depends on parameters alone.
    dynamics : casadi.Function
        `x_dot = dynamics(x, u, q, t)`.
    hold : casadi.Function
        `w = hold(u, q)`: what follows from q and inputs, for many evaluations with the same inputs.
    held_dynamics : casadi.Function
        `x_dot = held_dynamics(x, w, q, t)`.
    """

    prepare: ca.Function
    dynamics: ca.Function
    hold: ca.Function
    held_dynamics: ca.Function


def prepared(functions: Functions) -> Prepared:
    """The dynamics of a vehicle in two steps."""
    x, u, p, t = functions.x, functions.u, functions.p, functions.t
    by_parameters = Collector(p, ca.vertcat(x, u, t), ready=ca.SX(0, 1), name="q")
    rates = by_parameters.rewrite(functions.with_acceleration(acceleration(functions)))
    q = by_parameters.symbols
    by_inputs = Collector(ca.vertcat(u, q), ca.vertcat(x, t), ready=q, name="w")
    held_rates = by_inputs.rewrite(rates)
    w = by_inputs.symbols
    return Prepared(
        ca.Function("prepare", [p], [by_parameters.coefficients], ["p"], ["q"]),
        ca.Function("dynamics", [x, u, q, t], [rates], ["x", "u", "q", "t"], ["x_dot"]),
        ca.Function("hold", [u, q], [by_inputs.coefficients], ["u", "q"], ["w"]),
        ca.Function("held_dynamics", [x, w, q, t], [held_rates], ["x", "w", "q", "t"], ["x_dot"]),
    )


def acceleration(functions: Functions) -> ca.SX:
    """d(nu)/dt from x, u, p, t, with the inertial wrenches stated by their momentum."""
    f, rows = functions, functions.vehicle.dof_indices
    inertia = find_inertia(f.stated, f.vehicle.composition.signals, f.convert, f.p, rows)
    others = sum((w for i, w in f.wrenches.items() if i not in inertia.ids), ca.SX(len(rows), 1))
    others = ca.substitute(others, f.actuation, f.chain_output)
    other_mass = -ca.jacobian(others, f.nu_dot)
    still = ca.substitute(others, f.nu_dot, ca.SX.zeros(f.nu_dot.shape))
    mass = (inertia.mass + inertia.water_mass)[list(rows), list(rows)] + other_mass
    force, drift = _inertial_force(f, inertia)
    force, drift = force[list(rows)], drift[list(rows)]
    return solution(mass, still + force + other_mass @ drift, ca.vertcat(f.x, f.u, f.t)) - drift


def _inertial_force(f: Functions, inertia: Inertia) -> tuple[ca.SX, ca.SX]:
    """Inertial forces where nu_dot is the negative of a drift of the water, and that drift; shapes (6, 1)."""
    composition = f.vehicle.composition
    s, flows = composition.signals, composition.of_kind(Flow)
    nu, nu_r, nu_r_dot = map(f.convert.matrix, (s.nu, s.nu_r, s.nu_r_dot))
    drift = ca.substitute(nu_r_dot, f.nu_dot, ca.SX.zeros(f.nu_dot.shape))
    if flows and not is_galilean(inertia, f.p, composition.dofs):
        force = inertia.water_mass @ drift + kirchhoff(inertia.water_momentum, nu_r)
        return -force - kirchhoff(inertia.momentum, nu), ca.SX(6, 1)
    # A steady flow may as well be at rest, with the vehicle moving through it; its rate remains.
    momentum = inertia.momentum + inertia.water_momentum
    return -inertia.mass[:, :3] @ f.water_rate - kirchhoff(momentum, nu_r), drift
