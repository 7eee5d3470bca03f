"""Derivatives of the dynamics in factored form, cheaper than the dense Jacobians where only some are needed."""

from __future__ import annotations

import casadi as ca

from .functions import Functions, solve_symmetric


def tangents(functions: Functions) -> ca.Function:
    """`(x_dot, W, R_x, R_p) = tangents(x, u, p, t)`, with R_x and R_p sparse.

    The pose rates, the residual at the acceleration and the rates of owned states are stacked to r. Then
    d(x_dot)/dz = dr/dz, with the rows of the acceleration multiplied by W, the inverse of M. That is what
    differentiating M(x, p) a = f(x, u, p) gives, and it keeps the sparsity of r.
    """
    stacked = _stacked(functions)
    acceleration = functions.x_dot[acceleration_rows(functions)]
    n = functions.nu_dot.numel()
    inverse = solve_symmetric(functions.mass_matrix, ca.SX.eye(n))
    slopes = [
        ca.substitute(ca.jacobian(stacked, v), functions.nu_dot, acceleration) for v in (functions.x, functions.p)
    ]
    outputs = ca.cse([functions.x_dot, ca.densify(inverse), *slopes])
    inputs = [functions.x, functions.u, functions.p, functions.t]
    names = ["x", "u", "p", "t"], ["x_dot", "W", "R_x", "R_p"]
    return ca.Function("tangents", inputs, [ca.densify(outputs[0]), *outputs[1:]], *names)


def acceleration_rows(functions: Functions) -> slice:
    """Rows of x_dot that hold the acceleration."""
    n = functions.nu_dot.numel()
    return slice(n, 2 * n)


def _stacked(functions: Functions) -> ca.SX:
    parts = [functions.residual, functions.memory_rates]
    driven = [ca.substitute(part, functions.actuation, functions.chain_output) for part in parts]
    return ca.vertcat(functions.pose_rate, *driven, functions.chain_rates)
