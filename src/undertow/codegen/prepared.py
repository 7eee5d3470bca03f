"""The dynamics in two steps: what depends on parameters alone, then the rest with few operations."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from .collecting import Collector


@dataclass(frozen=True)
class Prepared:
    """The dynamics for many evaluations with the same parameters.

    Attributes
    ----------
    prepare : casadi.Function
        `q = prepare(p)`: coefficients, and the inverse of the mass matrix where it depends on parameters alone.
    dynamics : casadi.Function
        `x_dot = dynamics(x, u, q, t)`.
    hold : casadi.Function
        `w = hold(u, q)`: what follows from coefficients and inputs, for many evaluations with the same inputs.
    held_dynamics : casadi.Function
        `x_dot = held_dynamics(x, w, q, t)`.
    """

    prepare: ca.Function
    dynamics: ca.Function
    hold: ca.Function
    held_dynamics: ca.Function


def prepared(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX, x_dot: ca.SX) -> Prepared:
    """The two steps of an expression for x_dot."""
    by_parameters = Collector(p, ca.vertcat(x, u, t), ready=ca.SX(0, 1), name="q")
    rates = by_parameters.rewrite(x_dot)
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
