"""PD and PID loops in pose rates: a linear loop, and bounds on all that it leaves out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product as product_of
from typing import NamedTuple

import numpy as np
import sympy as sm

from undertow.errors import UndertowError
from undertow.model.symbols import symbol
from undertow.typing import Array

from .attitude import ANGLES, Interval, enclose, enclosing
from .commands import Commands
from .definite import SETTINGS as PROOFS
from .embedding import inverse_of_inertia, plain, rotation_of, sign_cases, sizes_and_signs
from .problem import Problem


@dataclass(frozen=True)
class MotionSettings:
    """How finely what is left over is bounded."""

    cuts: int = 4  # of each angle's range, in which bounds on derivatives are taken


SETTINGS = MotionSettings()


class Forces(NamedTuple):
    """(C + D) nu as D nu + Q(nu, nu), and what signs of velocities make of either."""

    D: Array  # shape (n, n)
    D_signs: Array  # bound on what signs add to it
    Q: Array  # symmetric in its last two places, shape (n, n, n)
    Q_signs: Array  # bound on all products in which a magnitude or a sign stands


class Leftover(NamedTuple):
    """Bounds for angles up to a cap, by derivatives in the angles.

    With v the pose rates, r = J' F - (C + D) nu and F the force of the law in pose coordinates,

        v_dot = J M^-1 r + J_dot nu = W F - P v + Gamma(v, v) + what signs add,

    W = J M^-1 J' and P = J M^-1 D J^-1. Without tilt and with the heading of the set-point J is the identity.
    """

    W: Array  # dW/dangle on an even keel, shape (angles, n, n)
    P: Array
    J: Array  # |dJ/dangle| up to the cap, as all that follow but Gamma
    J_inverse: Array
    W_bend: Array  # |second derivatives| / 2, shape (angles, angles, n, n)
    P_bend: Array
    Gamma: Array  # without tilt, symmetric in its last two places, shape (n, n, n)
    Gamma_slope: Array  # shape (angles, n, n, n)


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

    # --- what the loop is made of -----------------------------------------------------------------
    def _forces(self) -> Forces:
        n, plant = self.n, self.plant
        nu, (sizes, signs) = list(plant.nu), sizes_and_signs(plant)
        found = Forces(*(np.zeros((n,) * k) for k in (2, 2, 3, 3)))
        moving = (plain(plant, plant.C + plant.D) * plant.nu).applyfunc(sm.expand)
        for i, entry in enumerate(moving):
            if not entry.is_polynomial(*nu, *sizes, *signs):
                raise UndertowError("damping is no polynomial in velocities and their magnitudes")
            for powers, value in sm.Poly(entry, *nu, *sizes, *signs).terms():
                self._add(found, i, powers, float(value))
        return found

    def _add(self, found: Forces, i: int, powers: tuple[int, ...], value: float) -> None:
        n = self.n
        own = [k for k in range(n) for _ in range(powers[k] + powers[n + k])]
        signed = any(powers[n:])
        if len(own) > 2:
            raise UndertowError("damping grows faster than in proportion to a velocity: no V is searched for")
        if len(own) == 1:
            (found.D_signs if signed else found.D)[i, own[0]] += abs(value) if signed else value
        for j, k in {tuple(own), tuple(own[::-1])} if len(own) == 2 else ():
            part = value if j == k else value / 2
            (found.Q_signs if signed else found.Q)[i, j, k] += abs(part) if signed else part

    @cached_property
    def _inertias(self) -> Interval:
        """M^-1 in every case of the signs, shape (cases, n, n)."""
        signs, M = sizes_and_signs(self.plant)[1], plain(self.plant, self.plant.M)
        switching = [i for i, s in enumerate(signs) if s in M.free_symbols]
        cases = sign_cases(switching, self.n)
        return inverse_of_inertia(enclosing(signs, M)(*map(enclose, cases.T)))

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
    def _functions(self) -> dict[str, object]:
        J, Ji, own = self.plant.J, self.plant.J_inverse, [symbol(a) for a in ANGLES]
        every = [symbol(a) for a in self.angles]
        found = {"J": J, "i": Ji} | {f"J{k}": J.diff(a) for k, a in enumerate(every)}
        found |= {f"i{k}": Ji.diff(a) for k, a in enumerate(every)}
        pairs = [(k, m) for k in range(len(every)) for m in range(k + 1)]
        found |= {f"J{m}{k}": J.diff(every[k], every[m]) for k, m in pairs}
        found |= {f"i{m}{k}": Ji.diff(every[k], every[m]) for k, m in pairs}
        return {name: enclosing(own, matrix) for name, matrix in found.items()}

    def _at(self, caps: Array, cuts: int) -> dict[str, Interval]:
        """J, its inverse and their derivatives on boxes of angles, (boxes, 1, n, n)."""
        reach = dict(zip(self.angles, caps, strict=True))
        edges = [
            np.linspace(-reach.get(a, 0.0), reach.get(a, 0.0), cuts + 1 if a in reach else 2) for a in ANGLES
        ]
        low, high = (np.meshgrid(*[e[part] for e in edges]) for part in (slice(-1), slice(1, None)))
        box = [Interval(lo.ravel(), hi.ravel()) for lo, hi in zip(low, high, strict=True)]
        found = {name: function(*box) for name, function in self._functions.items()}  # type: ignore[operator]
        return {name: Interval(m.lo[:, None], m.hi[:, None]) for name, m in found.items()}

    def leftover(self, caps: Array) -> Leftover:
        """The bounds for angles up to these, rad, by angle."""
        at, level, count = self._at(caps, SETTINGS.cuts), self._at(0 * caps, 1), range(len(self.angles))
        W, P = (
            self._turned(level, at, "J", self.inverse),
            self._turned(level, at, "i", self.inverse @ self.forces.D),
        )
        slopes = ([at[f"{m}{a}"].size.max(axis=(0, 1)) for a in count] for m in "Ji")
        J, Ji = (np.array(m).reshape(-1, self.n, self.n) for m in slopes)
        return Leftover(W[0], P[0], J, Ji, W[1], P[1], *self._curved(level, at))

    def _turned(
        self, level: dict[str, Interval], at: dict[str, Interval], right: str, matrix: Array
    ) -> tuple[Array, Array]:
        """J matrix J' or J matrix J^-1: first derivatives on an even keel, and half of the second ones."""
        count, shape = range(len(self.angles)), (len(self.angles),) * 2 + matrix.shape
        # A multiple of the identity in the block of the translations, or in either block, is not turned.
        left = matrix - self._even(matrix, right == "i")

        def of(stack: dict[str, Interval], name: str) -> Interval:
            return stack[f"i{name}"] if right == "i" else stack[f"J{name}"].T

        def product(stack: dict[str, Interval], a: str, b: str) -> Interval:
            return stack[f"J{a}"] @ left @ of(stack, b)

        first = [(product(level, f"{a}", "") + product(level, "", f"{a}")).middle[0, 0] for a in count]
        second = np.zeros(shape)
        for a, b in product_of(count, repeat=2):
            both = f"{min(a, b)}{max(a, b)}"
            pairs = ((both, ""), ("", both), (f"{a}", f"{b}"), (f"{b}", f"{a}"))
            second[a, b] = (
                sum((product(at, *p) for p in pairs), enclose(0 * matrix)).size.max(axis=(0, 1)) / 2
            )
        return np.array(first).reshape(-1, *matrix.shape), second

    def _even(self, matrix: Array, both: bool) -> Array:
        dofs, mean = np.array(self.plant.vehicle.dof_indices), np.zeros(self.n)
        for block in (dofs < 3, dofs >= 3) if both else (dofs < 3,):
            mean[block] = np.diag(matrix)[block].mean() if block.any() else 0.0
        return np.diag(mean)

    def _curved(self, level: dict[str, Interval], at: dict[str, Interval]) -> tuple[Array, Array]:
        """Gamma on an even keel, and magnitudes of its slopes."""
        n, n3, count = self.n, (self.n,) * 3, range(len(self.angles))
        A = enclose(-np.tensordot(self.inverse, self.forces.Q, 1))

        def curved(J: Interval, left: Interval, right: Interval) -> Interval:
            """J (left' A right) over the places of the first index."""
            inner, boxes = left.T @ A @ right, len(J.lo)
            flat = J @ Interval(*(m.reshape(-1, 1, n, n * n) for m in (inner.lo, inner.hi)))
            return Interval(*(m.reshape(boxes, *n3) for m in (flat.lo, flat.hi)))

        def turning(rows: list[Interval]) -> Interval:
            """J_dot J^-1 v as a form in v: of each angle's rate, what it turns."""
            found = np.zeros((2, len(rows[0].lo) if rows else 1, *n3))
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
            slopes.append(
                sym(sum((curved(*(at[p] for p in names)) for names in parts), kin)).size.max(axis=0)
            )
        flat = turning([level[f"J{a}"] @ level["i"] for a in count]) + curved(
            level["J"], level["i"], level["i"]
        )
        return sym(flat).middle[0], np.array(slopes).reshape(-1, *n3)

    @cached_property
    def magnitudes(self) -> tuple[Array, ...]:
        """|M^-1| and what it makes of the forces' magnitudes: D_signs, |Q| and Q_signs."""
        M = np.abs(self.inverse)
        of = self.forces
        Q = np.abs(np.tensordot(self.inverse, of.Q, 1))
        return M, M @ of.D_signs, Q * (1 + PROOFS.room), np.tensordot(M, of.Q_signs, 1)
