"""Systems of linear equations, symbolically."""

from __future__ import annotations

import casadi as ca


def solve_symmetric(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solution of a symmetric positive definite system by L D L', keeping structural zeros."""
    if matrix.shape == (1, 1):
        return right / matrix
    d, lt, permutation = ca.ldl(matrix)
    return ca.ldl_solve(right, d, lt, permutation)


def solution(matrix: ca.SX, right: ca.SX, moving: ca.SX) -> ca.SX:
    """Solution of such a system, by the inverse of the matrix if no `moving` symbol is in it."""
    if ca.depends_on(matrix, moving):
        return solve_symmetric(matrix, right)
    return solve_symmetric(matrix, ca.SX.eye(matrix.shape[0])) @ right
