"""PD and PID loops in pose rates: a linear loop, and bounds on all that it leaves out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product as product_of
from typing import NamedTuple

import numpy as np
import sympy as sm

from undertow.errors import UndertowError
from undertow.model.symbols import symbol
from undertow.typing import Array, Index

from .attitude import ANGLES, Interval, enclose, enclosing
from .commands import Commands, inverse_of_inertia, inverses_of_inertia, plain, sizes_and_signs
from .definite import SETTINGS as PROOFS
from .embedding import motion_terms, rotation_of, sign_cases
from .problem import Problem


@dataclass(frozen=True)
class MotionSettings:
    """How finely what is left over is bounded."""

    cuts: int = 4  # of each angle's range, in which bounds on derivatives are taken


SETTINGS = MotionSettings()


class Forces(NamedTuple):
    """(C + D) nu as D nu + Q(nu, nu), and what signs of velocities make of either."""

    D: Array  # shape (n, n)
    D_signs: Array  # bound on what signs, and uncertain parameters, add to it
    Q: Array  # symmetric in its last two places, shape (n, n, n)
    Q_signs: Array  # bound on all products in which a magnitude, a sign or an uncertainty stands


class Leftover(NamedTuple):
    """Bounds for angles up to caps, by derivatives in the angles.

    With v the pose rates, r = J' F - (C + D) nu and F the force of the law in pose coordinates,

        v_dot = J M^-1 r + J_dot nu = W F - P v + Gamma(v, v) + what signs add,

    W = J M^-1 J' and P = J M^-1 D J^-1. Without tilt and with the heading of the set-point J is the identity.
    """

    W: Array  # dW/dangle on an even keel, shape (angles, n, n)
    P: Array
    Gamma: Array  # without tilt, symmetric in its last two places, shape (n, n, n)
    W_bent: Array  # halves of the second derivatives on an even keel, shape (angles, angles, n, n)
    P_bent: Array
    # Up to each cap, along the first axis:
    W_off: Array  # how far those are off elsewhere, shape (caps, angles, angles, n, n)
    P_off: Array
    J: Array  # |dJ/dangle|, shape (caps, angles, n, n)
    J_inverse: Array
    Gamma_slope: Array  # |dGamma/dangle|, shape (caps, angles, n, n, n)


class Motion:
    """The loop of one vehicle about set-points of any heading, z = (integral, error, -error rate).

    Coordinates are those of the set-point: north is where it heads. There pose rates follow the error
    exactly, and the frame's turning is in them, so that Coriolis forces are left only where inertia differs
    by axis.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.plant, self.commands = problem, problem.plant, Commands(problem)
        self.names = problem.coordinates
        self.n = len(self.names)
        self.gains = [np.diag(problem.values[g]) for g in ("K_I", "K_P", "K_V") if g in problem.values]
        self.size = len(self.gains) * self.n
        self.angles = [a for a in ANGLES if a in self.names]
        self.places = [self.names.index(a) for a in self.angles]
        self.plane = [self.names.index(c) for c in ("x", "y")] if {"x", "y", "psi"} <= set(self.names) else []
        self.forces = self._forces()
        rotation_of(self.plant)  # inertia that is the same for all translations is not turned (`_even`)
        if self.plant.J.xreplace(dict.fromkeys(map(symbol, ANGLES), sm.Integer(0))) != sm.eye(self.n):
            raise UndertowError(
                "pose rates are not velocities on an even keel: no bounds in time are searched for"
            )

    @property
    def angle_pairs(self) -> tuple[Index, Index]:
        """Places of the first and of the second angle of each pair."""
        return np.triu_indices(len(self.angles))

    # --- what the loop is made of -----------------------------------------------------------------
    def _forces(self) -> Forces:
        n, found = self.n, Forces(*(np.zeros((self.n,) * k) for k in (2, 2, 3, 3)))
        products: dict[tuple[int, ...], float] = {}
        for i, j, powers, value in motion_terms(self.plant, self.problem.spread):
            key = (i, *(p + (k == j) for k, p in enumerate(powers)))
            products[key] = products.get(key, 0.0) + value
        for (i, *own_powers), value in products.items():
            signed, own = any(own_powers[n:]), [k for k in range(2 * n) for _ in range(own_powers[k])]
            j, *rest = [k % n for k in own]
            linear, square = (found.D_signs, found.Q_signs) if signed else (found.D, found.Q)
            for a, b in [(j, *rest), (*rest, j)] if rest else []:
                square[i, a, b] += (abs(value) if signed else value) / 2
            if not rest:
                linear[i, j] += abs(value) if signed else value
        return found

    @cached_property
    def _inertias(self) -> Interval:
        """M^-1 in every case of the signs, of every parameter in its box, shape (cases, n, n)."""
        signs, M = sizes_and_signs(self.plant)[1], plain(self.plant, self.plant.M)
        switching = [i for i, s in enumerate(signs) if s in M.free_symbols]
        cases = sign_cases(switching, self.n)
        return inverses_of_inertia(self.problem, cases).whole

    @cached_property
    def inverse(self) -> Array:
        """M^-1 in the middle of all cases."""
        return np.asarray(0.5 * (self._inertias.lo.min(axis=0) + self._inertias.hi.max(axis=0)))

    @cached_property
    def inertia_off(self) -> Array:
        """|delta| of M^-1 = (I + delta) `inverse`, over all cases."""
        M = inverse_of_inertia(enclose(self.inverse[None]))
        return np.asarray((self._inertias @ M - np.eye(self.n)).size.max(axis=0))

    def law(self, heading: float) -> tuple[Array, Array, Array]:
        """F as rows on z for set-points of one heading; its slope in the heading; and its part that turns."""
        turn, quarter = np.eye(self.n), np.zeros((self.n, self.n))
        if self.plane:
            c, s = np.cos(heading), np.sin(heading)
            turn[np.ix_(self.plane, self.plane)] = [[c, -s], [s, c]]
            quarter[np.ix_(self.plane, self.plane)] = [[0.0, -1.0], [1.0, 0.0]]
        own = [turn.T @ K @ turn for K in self.gains]
        turned = [K @ quarter - quarter @ K for K in own]
        apart = [0.5 * (K + quarter @ K @ quarter) for K in own]  # less its mean over the plane
        force, slope, turning = (np.hstack([*m[:-1], -m[-1]]) for m in (own, turned, apart))
        return force, slope[self.plane], turning[self.plane]

    def linear(self, force: Array) -> Array:
        """z_dot = A z without what is left over."""
        n, none, unit = self.n, np.zeros((self.n, self.n)), np.eye(self.n)
        A = [np.hstack([none] * (len(self.gains) - 1) + [-unit])]
        if len(self.gains) == 3:
            A.insert(0, np.hstack([none, unit, none]))
        v = self.inverse @ force
        v[:, -n:] -= self.inverse @ self.forces.D
        return np.vstack([*A, v])

    @cached_property
    def holding(self) -> Array:
        """Rows on the errors of roll and pitch for what holding the weight changes by, (commands, n)."""
        found = np.zeros((len(self.commands.limits), self.n))
        slopes = self.commands.holding_slopes({}).middle[0] if len(found) else np.zeros((0, 2))
        for slope, a in zip(slopes.T, ("phi", "theta"), strict=True):
            if a in self.names:
                found[:, self.names.index(a)] = -slope  # an angle is the error turned round
        return found

    # --- what is left over ------------------------------------------------------------------------
    @cached_property
    def _turns(self) -> tuple[list[str], Callable[..., Interval]]:
        """J, its inverse and their derivatives: their names, and all of them as one matrix."""
        J, Ji, every = self.plant.J, self.plant.J_inverse, [symbol(a) for a in self.angles]
        pairs = [(k, m) for k in range(len(every)) for m in range(k + 1)]
        found = {"J": J, "i": Ji}
        for name, matrix in (("J", J), ("i", Ji)):
            found |= {f"{name}{k}": matrix.diff(a) for k, a in enumerate(every)}
            found |= {f"{name}{m}{k}": found[f"{name}{k}"].diff(every[m]) for k, m in pairs}
        return [*found], enclosing([symbol(a) for a in ANGLES], sm.Matrix.vstack(*found.values()))

    def _at(self, caps: Array, cuts: int) -> dict[str, Interval]:
        """J, its inverse and their derivatives on boxes of angles up to each cap, (caps * boxes, 1, n, n)."""
        cuts_of = [cuts if a in self.angles else 1 for a in ANGLES]
        rows = np.array([*product_of(*map(range, cuts_of))])  # places of a box
        most = np.zeros((len(caps), len(ANGLES)))
        most[:, [ANGLES.index(a) for a in self.angles]] = caps
        ends = ((2 * (rows + side) / cuts_of - 1) * most[:, None] for side in (0, 1))
        low, high = (e.reshape(-1, len(ANGLES)).T for e in ends)
        names, function = self._turns
        found = function(*map(Interval, low, high)).reshape(-1, len(names), 1, self.n, self.n)
        return {name: found[:, k] for k, name in enumerate(names)}

    def leftover(self, caps: Array) -> Leftover:
        """The bounds for angles up to these, rad, shape (caps, angles)."""
        at, level, count = self._at(caps, SETTINGS.cuts), self._at(0 * caps[:1], 1), range(len(self.angles))
        W = self._turned(level, at, "J", self.inverse, len(caps))
        P = self._turned(level, at, "i", self.inverse @ self.forces.D, len(caps))
        slopes = ([_largest(at[f"{m}{a}"].size[:, 0], len(caps)) for a in count] for m in "Ji")
        J, Ji = (np.array(m).reshape(-1, len(caps), self.n, self.n).swapaxes(0, 1) for m in slopes)
        Gamma, bent = self._curved(level, at, len(caps))
        return Leftover(W[0], P[0], Gamma, W[1], P[1], W[2], P[2], J, Ji, bent)

    def _turned(
        self, level: dict[str, Interval], at: dict[str, Interval], right: str, matrix: Array, caps: int
    ) -> tuple[Array, Array, Array]:
        """J matrix J' or J matrix J^-1: first derivatives, halves of second ones, how far these are off."""
        count, shape = range(len(self.angles)), (len(self.angles),) * 2 + matrix.shape
        # A multiple of the identity in the block of the translations, or in either block, is not turned.
        left = matrix - self._even(matrix, right == "i")

        def of(stack: dict[str, Interval], name: str) -> Interval:
            return stack[f"i{name}"] if right == "i" else stack[f"J{name}"].T

        def product(stack: dict[str, Interval], a: str, b: str) -> Interval:
            return stack[f"J{a}"] @ left @ of(stack, b)

        def twice(stack: dict[str, Interval], a: int, b: int) -> Interval:
            both = f"{min(a, b)}{max(a, b)}"
            pairs = ((both, ""), ("", both), (f"{a}", f"{b}"), (f"{b}", f"{a}"))
            return 0.5 * sum((product(stack, *p) for p in pairs), enclose(0 * matrix))

        first = [(product(level, f"{a}", "") + product(level, "", f"{a}")).middle[0, 0] for a in count]
        bent, off = np.zeros(shape), np.zeros((caps, *shape))
        for a, b in product_of(count, repeat=2):
            bent[a, b] = twice(level, a, b).middle[0, 0]
            off[:, a, b] = _largest((twice(at, a, b) - bent[a, b]).size[:, 0], caps)
        return np.array(first).reshape(-1, *matrix.shape), bent, off + PROOFS.rounding * np.abs(bent)

    def _even(self, matrix: Array, both: bool) -> Array:
        dofs, mean = np.array(self.plant.vehicle.dof_indices), np.zeros(self.n)
        for block in (dofs < 3, dofs >= 3) if both else (dofs < 3,):
            mean[block] = np.diag(matrix)[block].mean() if block.any() else 0.0
        return np.diag(mean)

    def _curved(self, level: dict[str, Interval], at: dict[str, Interval], caps: int) -> tuple[Array, Array]:
        """Gamma on an even keel, and magnitudes of its slopes up to each cap."""
        n, n3, count = self.n, (self.n,) * 3, range(len(self.angles))
        A = enclose(-np.tensordot(self.inverse, self.forces.Q, 1))

        def curved(J: Interval, left: Interval, right: Interval) -> Interval:
            """J (left' A right) over the places of the first index."""
            inner, boxes = left.T @ A @ right, len(J)
            return (J @ inner.reshape(-1, 1, n, n * n)).reshape(boxes, *n3)

        def turning(rows: list[Interval]) -> Interval:
            """J_dot J^-1 v as a form in v: of each angle's rate, what it turns."""
            found = np.zeros((2, len(rows[0]) if rows else 1, *n3))
            for place, row in zip(self.places, rows, strict=True):
                found[:, :, :, place] = row.lo[:, 0], row.hi[:, 0]
            return Interval(*found)

        def sym(form: Interval) -> Interval:
            return 0.5 * (form + form.T)

        slopes = []
        for b in count:
            second = [at[f"J{min(a, b)}{max(a, b)}"] for a in count]
            kin = turning([second[a] @ at["i"] + at[f"J{a}"] @ at[f"i{b}"] for a in count])
            parts = (("J", f"i{b}", "i"), ("J", "i", f"i{b}"), (f"J{b}", "i", "i"))
            whole = sym(sum((curved(*(at[p] for p in names)) for names in parts), kin)).size
            slopes.append(_largest(whole, caps))
        flat = turning([level[f"J{a}"] @ level["i"] for a in count]) + curved(
            level["J"], level["i"], level["i"]
        )
        return sym(flat).middle[0], np.array(slopes).reshape(-1, caps, *n3).swapaxes(0, 1)

    @cached_property
    def magnitudes(self) -> tuple[Array, ...]:
        """|M^-1| and what it makes of the forces' magnitudes: D_signs, |Q| and Q_signs."""
        M = np.abs(self.inverse)
        of = self.forces
        Q = np.abs(np.tensordot(self.inverse, of.Q, 1))
        return M, M @ of.D_signs, Q * (1 + PROOFS.room), np.tensordot(M, of.Q_signs, 1)


def _largest(sizes: Array, caps: int) -> Array:
    """The largest over the boxes of each cap."""
    return np.asarray(sizes.reshape(caps, -1, *sizes.shape[1:]).max(axis=1))
