"""PD and PID loops in pose rates: the responses of a linear loop, and bounds on all that it leaves out.

What a linear loop makes of its start, its heading and of pushes is bounded piece by piece of time.

Motion that it drives is of second order in the start, and of first order in the heading. With z_1 = sum
of V_j e^{l_j t} (C_j s) for a start s, z_2' = A z_2 + q(z_1, z_1) has the solution

    z_2 = sum over j, k of Z_jk (C_j s)(C_k s) e^{(l_j + l_k) t} + sum over m of Y_m(s) e^{l_m t},

and z_h' = A z_h + B z_1, by which motion changes with the heading of the set-point, the solution

    z_h = sum over j of (Z_j + t Y_j)(s) e^{l_j t}.

Nothing of either has to be exact: what it misses of the equation is bounded and pushes what is left.
"""

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
from .commands import Commands, inverse_of_inertia, inverses_of_inertia, numeric_matrix, sizes_and_signs
from .definite import SETTINGS as PROOFS
from .embedding import motion_terms, rotation_of, sign_cases
from .problem import Problem
from .responses import Amplitudes, Modes, bounds_within


@dataclass(frozen=True)
class MotionSettings:
    """How what a linear loop leaves out is bounded; it does not decide what is proved."""

    angle_cuts: int = 4  # of each angle's range, in which bounds on derivatives are taken


SETTINGS = MotionSettings()


# --- of second order in the start, of first order in the heading --------------------------------
class QuadraticForm(NamedTuple):
    """q(z, z): of each angle times what it turns, and of products of rates."""

    angles: Array  # rows on z, (angles, states)
    pull: Array  # what a unit of each angle turns, rows on z, (angles, n, states)
    Gamma: Array  # (n, n, n)
    # The same of magnitudes: nothing that cancels in `pull` does here.
    magnitude: Array


class DrivenMotion(NamedTuple):
    """Bounds on a motion that the linear loop drives, and on what is missed of its equation."""

    signals: Array  # (pieces, signals)
    defect: Array  # at any time of a piece, (pieces, states)
    initial_defect: Array  # bound on the motion at the start, which should be zero, by state


class ComplexModes(NamedTuple):
    """The modes as z = sum of V_j e^{l_j t} (C_j z(0)), one of each pair that is conjugate."""

    exponents: Array
    V: Array  # (states, modes)
    C: Array  # (modes, states)
    radius: Array  # of C
    weights: Array  # one, or two where it stands for a pair


class StartBox(NamedTuple):
    """A box of errors, of which those in the plane stand in any frame: there it is a disc."""

    box: Array
    plane: list[int]

    @property
    def reach(self) -> Array:
        """The largest of each error in any frame."""
        found = self.box.astype(float).copy()
        if self.plane:
            found[self.plane] = np.hypot(*self.box[self.plane])
        return found * (1 + PROOFS.room)

    def linear(self, weights: Array) -> Array:
        """The largest sum over errors of a share of each, of magnitudes along the first axis."""
        reach = self.reach
        rest = [c for c in range(len(reach)) if c not in self.plane]
        found = np.tensordot(reach[rest], weights[rest], 1)
        if self.plane:
            found = found + np.hypot(*weights[self.plane]) * reach[self.plane[0]]
        return np.asarray(found)

    def squares(self, weights: Array) -> Array:
        """The largest sum over pairs p <= q of errors, as `linear`, along the first axis (by `pairs`)."""
        p, q = self.pairs
        reach = self.reach
        found = weights * (reach[p] * reach[q]).reshape(-1, *[1] * (weights.ndim - 1))
        if not self.plane:
            return np.asarray(found.sum(axis=0))
        x, y = self.plane
        index = {(int(a), int(b)): k for k, (a, b) in enumerate(zip(p, q, strict=True))}
        xx, yy, xy = (found[index[pair]] for pair in ((x, x), (y, y), (x, y)))
        total = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), 0.5 * xy)
        rest = [c for c in range(len(reach)) if c not in self.plane]
        for c in rest:
            total = total + np.hypot(*(found[index[min(a, c), max(a, c)]] for a in self.plane))
            total = total + sum(found[index[c, d]] for d in rest if d >= c)
        return np.asarray(total)

    @property
    def pairs(self) -> tuple[Index, Index]:
        """Places of the first and of the second error of each pair."""
        return np.triu_indices(len(self.box))


def complex_modes(basis: Modes) -> ComplexModes:
    """One of each pair of modes that are conjugate, and those that are real."""
    first, pair = basis.block_starts, basis.rates.imag != 0
    T, inverse, inverse_radius = basis.T.lo, basis.inverse.middle, basis.inverse.radius
    V = T[:, first].astype(complex)
    V[:, pair] = 0.5 * (T[:, first[pair]] - 1j * T[:, first[pair] + 1])
    C, radius = inverse[first].astype(complex), inverse_radius[first].copy()
    C[pair] += 1j * inverse[first[pair] + 1]
    radius[pair] += inverse_radius[first[pair] + 1]
    return ComplexModes(-basis.rates.real + 1j * basis.rates.imag, V, C, radius, np.where(pair, 2.0, 1.0))


def _all_modes(modes: ComplexModes) -> tuple[Array, Array, Array]:
    """Exponents, V and C of every mode."""
    pairs = np.flatnonzero(modes.weights == 2)
    exponents = np.concatenate([modes.exponents, modes.exponents[pairs].conj()])
    V = np.concatenate([modes.V, modes.V[:, pairs].conj()], axis=1)
    return exponents, V, np.concatenate([modes.C, modes.C[pairs].conj()])


def form_products(form: QuadraticForm, V: Array) -> Array:
    """q of each pair of vectors, shape (n, modes, modes)."""
    n, v = len(form.Gamma), V[-len(form.Gamma) :]
    by_angle = np.einsum("aj,aik->ijk", form.angles @ V, form.pull @ V)
    both = np.einsum("ipk,pj->ijk", (form.Gamma.reshape(n * n, n) @ v).reshape(n, n, -1), v)
    return np.asarray(0.5 * (by_angle + by_angle.swapaxes(1, 2)) + both)


def absolute_form(form: QuadraticForm) -> QuadraticForm:
    """The form that bounds |q| of vectors by their magnitudes."""
    return QuadraticForm(np.abs(form.angles), form.magnitude, np.abs(form.Gamma), form.magnitude)


def second_order_motion(
    basis: Modes, A: Array, form: QuadraticForm, rows: Array, starts: StartBox, times: Array
) -> DrivenMotion:
    """z_2 of starts in a box of errors."""
    n, size = len(form.Gamma), len(A)
    modal = complex_modes(basis)
    exponents, V, C = _all_modes(modal)
    errors = slice(size - 2 * n, size - n)
    C_radius = np.concatenate([modal.radius, modal.radius[modal.weights == 2]])[:, errors]
    C = C[:, errors]
    j, k = np.triu_indices(len(exponents))
    upper = (exponents[j] + exponents[k]).imag >= 0  # the others are conjugate to these
    j, k = j[upper], k[upper]
    both = exponents[j] + exponents[k]
    weights = np.where(j == k, 1.0, 2.0) * np.where(both.imag > 0, 2.0, 1.0)
    q = np.zeros((len(j), size), dtype=complex)
    q[:, -n:] = (form_products(form, V)[:, j, k] * weights).T
    system = both[:, None, None] * np.eye(size) - A
    Z = np.asarray(np.linalg.solve(system, q[..., None]))[..., 0]
    p, r = starts.pairs
    same = np.where(p == r, 0.5, 1.0)
    coefficient = (C[j][:, p] * C[k][:, r] + C[k][:, p] * C[j][:, r]) * same  # (l, pairs)
    total = (coefficient.T @ Z).real  # of z_2 at the start without Y, (pairs, states)
    Y = (
        -modal.V.T[:, None]
        * (np.linalg.inv(V)[: len(modal.V.T)] @ total.T)[..., None]
        * modal.weights[:, None, None]
    )
    # What is missed: of the equation by rounding and by the modes, of the start, and of the rows C.
    reach, abs_Z = starts.reach, np.abs(Z)
    defect_Z = np.abs(np.einsum("lst,lt->ls", system, Z) - q) + abs_Z @ basis.residual.T
    defect_Z += PROOFS.rounding * (abs_Z @ np.abs(A).T + np.abs(both)[:, None] * abs_Z + np.abs(q))
    abs_C = np.abs(C) @ reach
    C_off = C_radius @ reach + PROOFS.rounding * abs_C
    defect = (defect_Z * (abs_C[j] * abs_C[k])[:, None]).sum(axis=0)
    magnitudes = form_products(absolute_form(form), np.abs(V)).real
    defect[-n:] += (magnitudes @ (abs_C + C_off)) @ (abs_C + C_off) - (magnitudes @ abs_C) @ abs_C
    abs_Y = np.abs(Y)
    initial_defect = np.abs(total + Y.sum(axis=0).real)
    initial_defect += PROOFS.rounding * (np.abs(coefficient).T @ abs_Z + abs_Y.sum(axis=0))
    # Modes that Y stands for are not quite those of A.
    defect += basis.residual @ (abs_Y.sum(axis=0).T @ (reach[p] * reach[r]))
    all_exponents = np.concatenate([both, modal.exponents])
    signals = starts.squares(_signals(rows, Z, coefficient, Y, all_exponents, times))
    decay = np.exp(-basis.rates.real.min() * times)[:, None]
    return DrivenMotion(signals.T, decay * defect, initial_defect.T @ (reach[p] * reach[r]))


def _signals(rows: Array, Z: Array, coefficient: Array, Y: Array, exponents: Array, times: Array) -> Array:
    """Bounds on rows on z_2 for each pair of starts of one, (pairs, signals, pieces)."""
    decaying = Y.swapaxes(0, 1).swapaxes(1, 2)  # (pairs, states, m)
    sizes = np.abs(rows) @ np.abs(Z).T  # (signals, l)
    decaying_abs = np.abs(rows) @ np.abs(decaying)  # (pairs, signals, m)
    weights = np.abs(coefficient).T
    total = weights @ sizes.T + decaying_abs.sum(axis=-1)
    # What hardly matters to a signal is not followed in time.
    relevant = total > PROOFS.level * total.max(axis=0)
    pair, signal = np.nonzero(relevant)
    amplitude = np.concatenate(
        [(rows @ Z.T)[signal] * coefficient.T[pair], (rows @ decaying)[pair, signal]], axis=-1
    )
    size = np.concatenate([sizes[signal] * weights[pair], decaying_abs[pair, signal]], axis=-1)
    found = total[..., None] * np.exp(exponents.real.max() * times)
    found[relevant] = bounds_within(Amplitudes(amplitude, size, PROOFS.level * size), exponents, times)
    return np.asarray(found * (1 + PROOFS.level))


def heading_motion(
    basis: Modes, A: Array, B: Array, rows: Array, starts: StartBox, times: Array
) -> DrivenMotion:
    """z_h of starts in a box of errors, for a heading that is one radian off."""
    n, size = len(starts.box), len(A)
    modal = complex_modes(basis)
    exponents, V, C = _all_modes(modal)
    C, radius = C[:, size - 2 * n : size - n], modal.radius[:, size - 2 * n : size - n]
    count, G = len(modal.exponents), np.linalg.inv(V) @ B @ V
    differences = exponents[None, :] - exponents[:, None]
    np.fill_diagonal(differences, 1.0)
    N = G / np.where(differences == 0, np.inf, differences)
    np.fill_diagonal(N, 0.0)
    C_modes, weights = C[:count], modal.weights[:, None, None]
    Z = (V @ N)[:, :count].T[:, :, None] * C_modes[:, None] - modal.V.T[:, :, None] * (N @ C)[:count, None]
    Y = modal.V.T[:, :, None] * (np.diag(G)[:count, None] * C_modes)[:, None]
    forcing = (B @ modal.V).T[:, :, None] * C_modes[:, None]  # each (modes, states, starts)
    at = modal.exponents[:, None, None]
    abs_Z, abs_Y, abs_A = np.abs(Z), np.abs(Y), np.abs(A) + np.abs(at) * np.eye(size)
    constant = np.abs(at * Z + Y - A @ Z - forcing) + basis.residual @ abs_Z
    constant += PROOFS.rounding * (
        abs_A @ abs_Z + abs_Y + np.abs(B) @ np.abs(modal.V).T[:, :, None] * np.abs(C_modes)[:, None]
    )
    constant += (np.abs(B) @ np.abs(modal.V)).T[:, :, None] * (radius + PROOFS.rounding * np.abs(C_modes))[
        :, None
    ]
    growing = np.abs(at * Y - A @ Y) + basis.residual @ abs_Y + PROOFS.rounding * (abs_A @ abs_Y)
    defect, growing_defect = (
        np.tensordot((m * weights).sum(axis=0), starts.reach, 1) for m in (constant, growing)
    )
    initial_defect = np.abs((Z * weights).sum(axis=0).real) + PROOFS.rounding * (abs_Z * weights).sum(axis=0)
    decay, later = np.exp(-basis.rates.real.min() * times), np.append(times[1:], times[-1])
    parts = [np.tensordot(rows, m * weights, ([1], [1])).transpose(2, 0, 1) for m in (Z, Y)]
    sizes = [np.tensordot(np.abs(rows), np.abs(m) * weights, ([1], [1])).transpose(2, 0, 1) for m in (Z, Y)]
    shape = (n * len(rows), count)
    pieces = [
        Amplitudes(*(m.reshape(shape) for m in (a, s, PROOFS.level * s)))
        for a, s in zip(parts, sizes, strict=True)
    ]
    signals = bounds_within(pieces[0], modal.exponents, times, pieces[1]).reshape(n, len(rows), -1)
    return DrivenMotion(
        starts.linear(signals).T,
        decay[:, None] * (defect + later[:, None] * growing_defect),
        initial_defect @ starts.reach,
    )


# --- what it leaves out ----------------------------------------------------------------------------
class VelocityForces(NamedTuple):
    """(C + D) nu as D nu + Q(nu, nu), and what signs of velocities make of either."""

    D: Array  # shape (n, n)
    D_signs: Array  # bound on what signs, and uncertain parameters, add to it
    Q: Array  # symmetric in its last two places, shape (n, n, n)
    Q_signs: Array  # bound on all products in which a magnitude, a sign or an uncertainty stands


class Derivatives(NamedTuple):
    """Bounds for angles up to caps, by derivatives in the angles.

    With v the pose rates, r = J' F - (C + D) nu and F the force of the law in pose coordinates,

        v_dot = J M^-1 r + J_dot nu = W F - P v + Gamma(v, v) + what signs add,

    W = J M^-1 J' and P = J M^-1 D J^-1. Without tilt and with the heading of the set-point J is the identity.
    """

    W: Array  # dW/dangle on an even keel, shape (angles, n, n)
    P: Array
    Gamma: Array  # without tilt, symmetric in its last two places, shape (n, n, n)
    W_second: Array  # halves of the second derivatives on an even keel, shape (angles, angles, n, n)
    P_second: Array
    # Up to each cap, along the first axis:
    W_error: Array  # how far those are off elsewhere, shape (caps, angles, angles, n, n)
    P_error: Array
    J: Array  # |dJ/dangle|, shape (caps, angles, n, n)
    J_inverse: Array
    Gamma_slope: Array  # |dGamma/dangle|, shape (caps, angles, n, n, n)


class PoseLoop:
    """The loop of one vehicle about set-points of any heading, z = (integral, error, -error rate).

    Coordinates are those of the set-point: north is where it heads. There pose rates follow the error
    exactly, and the frame's turning is in them, so that Coriolis forces remain only where inertia differs by
    axis.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.plant, self.commands = problem, problem.plant, Commands(problem)
        self.names = problem.coordinates
        self.n = len(self.names)
        self.gains = [np.diag(problem.values[g]) for g in ("K_I", "K_P", "K_V") if g in problem.values]
        self.size = len(self.gains) * self.n
        self.angles = [a for a in ANGLES if a in self.names]
        self.angle_indices = [self.names.index(a) for a in self.angles]
        self.plane = [self.names.index(c) for c in ("x", "y")] if {"x", "y", "psi"} <= set(self.names) else []
        self.forces = self._forces()
        rotation_of(self.plant)  # else inertia equal in all translations would turn, too (`_isotropic_part`)
        if self.plant.J.xreplace(dict.fromkeys(map(symbol, ANGLES), sm.Integer(0))) != sm.eye(self.n):
            raise UndertowError(
                "pose rates are not velocities on an even keel: no bounds in time are searched for"
            )

    @cached_property
    def angle_pairs(self) -> tuple[Index, Index]:
        """Places of the first and of the second angle of each pair."""
        return np.triu_indices(len(self.angles))

    # --- what the loop is made of -----------------------------------------------------------------
    def _forces(self) -> VelocityForces:
        n, found = self.n, VelocityForces(*(np.zeros((self.n,) * k) for k in (2, 2, 3, 3)))
        products: dict[tuple[int, ...], float] = {}
        for i, j, powers, value in motion_terms(self.plant, self.problem.parameter_box):
            key = (i, *(p + (k == j) for k, p in enumerate(powers)))
            products[key] = products.get(key, 0.0) + value
        for (i, *velocity_powers), value in products.items():
            signed = any(velocity_powers[n:])
            velocities = [k for k in range(2 * n) for _ in range(velocity_powers[k])]
            j, *rest = [k % n for k in velocities]
            linear, square = (found.D_signs, found.Q_signs) if signed else (found.D, found.Q)
            for a, b in [(j, *rest), (*rest, j)] if rest else []:
                square[i, a, b] += (abs(value) if signed else value) / 2
            if not rest:
                linear[i, j] += abs(value) if signed else value
        return found

    @cached_property
    def _inverses(self) -> Interval:
        """M^-1 in every case of the signs, of every parameter in its box, shape (cases, n, n)."""
        signs, M = sizes_and_signs(self.plant)[1], numeric_matrix(self.plant, self.plant.M)
        switching = [i for i, s in enumerate(signs) if s in M.free_symbols]
        cases = sign_cases(switching, self.n)
        return inverses_of_inertia(self.problem, cases).enclosure

    @cached_property
    def inverse(self) -> Array:
        """M^-1 in the middle of all cases."""
        return np.asarray(0.5 * (self._inverses.lo.min(axis=0) + self._inverses.hi.max(axis=0)))

    @cached_property
    def inertia_variation(self) -> Array:
        """|delta| of M^-1 = (I + delta) `inverse`, over all cases."""
        M = inverse_of_inertia(enclose(self.inverse[None]))
        return np.asarray((self._inverses @ M - np.eye(self.n)).magnitude.max(axis=0))

    def law_matrices(self, heading: float) -> tuple[Array, Array, Array]:
        """F as rows on z for set-points of one heading; its slope in the heading; and its part that turns."""
        rotation, quarter = np.eye(self.n), np.zeros((self.n, self.n))
        if self.plane:
            c, s = np.cos(heading), np.sin(heading)
            rotation[np.ix_(self.plane, self.plane)] = [[c, -s], [s, c]]
            quarter[np.ix_(self.plane, self.plane)] = [[0.0, -1.0], [1.0, 0.0]]
        matrices = [rotation.T @ K @ rotation for K in self.gains]
        slopes = [K @ quarter - quarter @ K for K in matrices]
        anisotropic = [0.5 * (K + quarter @ K @ quarter) for K in matrices]  # less its mean over the plane
        force, slope, turning = (np.hstack([*m[:-1], -m[-1]]) for m in (matrices, slopes, anisotropic))
        return force, slope[self.plane], turning[self.plane]

    def system_matrix(self, force: Array) -> Array:
        """z_dot = A z without what is left over."""
        n, none, unit = self.n, np.zeros((self.n, self.n)), np.eye(self.n)
        A = [np.hstack([none] * (len(self.gains) - 1) + [-unit])]
        if len(self.gains) == 3:
            A.insert(0, np.hstack([none, unit, none]))
        v = self.inverse @ force
        v[:, -n:] -= self.inverse @ self.forces.D
        return np.vstack([*A, v])

    @cached_property
    def restoring_rows(self) -> Array:
        """Rows on the errors of roll and pitch for what holding the weight changes by, (commands, n)."""
        found = np.zeros((len(self.commands.limits), self.n))
        slopes = self.commands.restoring_slopes({}).middle[0] if len(found) else np.zeros((0, 2))
        for slope, a in zip(slopes.T, ("phi", "theta"), strict=True):
            if a in self.names:
                found[:, self.names.index(a)] = -slope  # an angle is the error turned round
        return found

    @cached_property
    def mirror_symmetric(self) -> bool:
        """Whether the loop at a heading is the mirror image, port for starboard, of one at its opposite.

        Whatever is bounded by magnitudes, as what a coefficient differs by ahead and astern, may be either
        way: only the rest has to keep its signs.
        """
        signs, J = self._mirror_signs, self.plant.J
        reflected = {symbol(a): -symbol(a) for a in ("phi", "psi")}
        if sm.diag(*map(int, signs)) * J.xreplace(reflected) * sm.diag(*map(int, signs)) != J:
            return False
        inertia = numeric_matrix(self.plant, self.plant.M)
        if any(inertia[i, j] != 0 for i, j in zip(*np.nonzero(np.outer(signs, signs) < 0), strict=True)):
            return False
        odd = np.einsum("i,j,k->ijk", signs, signs, signs) < 0
        return not (self.forces.Q[odd].any() or self.forces.D[np.outer(signs, signs) < 0].any())

    @property
    def _mirror_signs(self) -> Array:
        """What a mirror between port and starboard does to each coordinate and velocity."""
        return np.array([-1.0 if d in (1, 3, 5) else 1.0 for d in self.plant.vehicle.dof_indices])

    @cached_property
    def command_rows(self) -> tuple[Array, Array]:
        """Rows on the force, and on the errors, that give the commands, each of shape (sides, commands, n).

        With a second side where commands of a motion and of its mirror image differ and both are meant.
        """
        rows = np.hstack([self.commands.B_inverse, self.restoring_rows])
        mirror = np.tile(self._mirror_signs, 2)
        mixed = rows[:, mirror > 0].any(axis=1) & rows[:, mirror < 0].any(axis=1)
        both = np.stack([rows, rows * mirror] if self.mirror_symmetric and mixed.any() else [rows])
        return both[..., : self.n], both[..., self.n :]

    # --- what is left over ------------------------------------------------------------------------
    @cached_property
    def _kinematic_terms(self) -> tuple[list[str], Callable[..., Interval]]:
        """J, its inverse and their derivatives: their names, and all of them as one matrix."""
        J, Ji, angles = self.plant.J, self.plant.J_inverse, [symbol(a) for a in self.angles]
        pairs = [(k, m) for k in range(len(angles)) for m in range(k + 1)]
        found = {"J": J, "i": Ji}
        for name, matrix in (("J", J), ("i", Ji)):
            found |= {f"{name}{k}": matrix.diff(a) for k, a in enumerate(angles)}
            found |= {f"{name}{m}{k}": found[f"{name}{k}"].diff(angles[m]) for k, m in pairs}
        return [*found], enclosing([symbol(a) for a in ANGLES], sm.Matrix.vstack(*found.values()))

    def _kinematics(self, caps: Array, cuts: int) -> dict[str, Interval]:
        """J, its inverse and their derivatives on boxes of angles up to each cap, (caps * boxes, 1, n, n)."""
        counts = [cuts if a in self.angles else 1 for a in ANGLES]
        boxes = np.array([*product_of(*map(range, counts))])  # places of a box
        largest = np.zeros((len(caps), len(ANGLES)))
        largest[:, [ANGLES.index(a) for a in self.angles]] = caps
        ends = ((2 * (boxes + side) / counts - 1) * largest[:, None] for side in (0, 1))
        low, high = (e.reshape(-1, len(ANGLES)).T for e in ends)
        names, function = self._kinematic_terms
        found = function(*map(Interval, low, high)).reshape(-1, len(names), 1, self.n, self.n)
        return {name: found[:, k] for k, name in enumerate(names)}

    def derivatives(self, caps: Array) -> Derivatives:
        """The bounds for angles up to these, rad, shape (caps, angles)."""
        at, level = self._kinematics(caps, SETTINGS.angle_cuts), self._kinematics(0 * caps[:1], 1)
        count = range(len(self.angles))
        W = self._derivatives(level, at, "J", self.inverse, len(caps))
        P = self._derivatives(level, at, "i", self.inverse @ self.forces.D, len(caps))
        slopes = ([_largest(at[f"{m}{a}"].magnitude[:, 0], len(caps)) for a in count] for m in "Ji")
        J, Ji = (np.array(m).reshape(-1, len(caps), self.n, self.n).swapaxes(0, 1) for m in slopes)
        Gamma, Gamma_slope = self._Gamma_bounds(level, at, len(caps))
        return Derivatives(W[0], P[0], Gamma, W[1], P[1], W[2], P[2], J, Ji, Gamma_slope)

    def _derivatives(
        self, level: dict[str, Interval], at: dict[str, Interval], right: str, matrix: Array, caps: int
    ) -> tuple[Array, Array, Array]:
        """J matrix J' or J matrix J^-1: first derivatives, halves of second ones, how far these are off."""
        count, shape = range(len(self.angles)), (len(self.angles),) * 2 + matrix.shape
        # A multiple of the identity in the block of the translations, or in either block, is not turned.
        anisotropic = matrix - self._isotropic_part(matrix, right == "i")

        def right_factor(stack: dict[str, Interval], name: str) -> Interval:
            return stack[f"i{name}"] if right == "i" else stack[f"J{name}"].T

        def product(stack: dict[str, Interval], a: str, b: str) -> Interval:
            return stack[f"J{a}"] @ anisotropic @ right_factor(stack, b)

        def half_second(stack: dict[str, Interval], a: int, b: int) -> Interval:
            both = f"{min(a, b)}{max(a, b)}"
            pairs = ((both, ""), ("", both), (f"{a}", f"{b}"), (f"{b}", f"{a}"))
            return 0.5 * sum((product(stack, *p) for p in pairs), enclose(0 * matrix))

        first = [(product(level, f"{a}", "") + product(level, "", f"{a}")).middle[0, 0] for a in count]
        second, remainder = np.zeros(shape), np.zeros((caps, *shape))
        for a, b in product_of(count, repeat=2):
            second[a, b] = half_second(level, a, b).middle[0, 0]
            remainder[:, a, b] = _largest((half_second(at, a, b) - second[a, b]).magnitude[:, 0], caps)
        return (
            np.array(first).reshape(-1, *matrix.shape),
            second,
            remainder + PROOFS.rounding * np.abs(second),
        )

    def _isotropic_part(self, matrix: Array, both: bool) -> Array:
        dofs, mean = np.array(self.plant.vehicle.dof_indices), np.zeros(self.n)
        for block in (dofs < 3, dofs >= 3) if both else (dofs < 3,):
            mean[block] = np.diag(matrix)[block].mean() if block.any() else 0.0
        return np.diag(mean)

    def _Gamma_bounds(
        self, level: dict[str, Interval], at: dict[str, Interval], caps: int
    ) -> tuple[Array, Array]:
        """Gamma on an even keel, and magnitudes of its slopes up to each cap."""
        n, n3, count = self.n, (self.n,) * 3, range(len(self.angles))
        A = enclose(-np.tensordot(self.inverse, self.forces.Q, 1))

        def transformed(J: Interval, left: Interval, right: Interval) -> Interval:
            """J (left' A right) over the places of the first index."""
            inner, boxes = left.T @ A @ right, len(J)
            return (J @ inner.reshape(-1, 1, n, n * n)).reshape(boxes, *n3)

        def J_dot_terms(rows: list[Interval]) -> Interval:
            """J_dot J^-1 v as a form in v: of each angle's rate, what it turns."""
            found = np.zeros((2, len(rows[0]) if rows else 1, *n3))
            for index, row in zip(self.angle_indices, rows, strict=True):
                found[:, :, :, index] = row.lo[:, 0], row.hi[:, 0]
            return Interval(*found)

        def symmetric(form: Interval) -> Interval:
            return 0.5 * (form + form.T)

        slopes = []
        for b in count:
            second = [at[f"J{min(a, b)}{max(a, b)}"] for a in count]
            rate_terms = J_dot_terms([second[a] @ at["i"] + at[f"J{a}"] @ at[f"i{b}"] for a in count])
            parts = (("J", f"i{b}", "i"), ("J", "i", f"i{b}"), (f"J{b}", "i", "i"))
            total = symmetric(
                sum((transformed(*(at[p] for p in names)) for names in parts), rate_terms)
            ).magnitude
            slopes.append(_largest(total, caps))
        on_even_keel = J_dot_terms([level[f"J{a}"] @ level["i"] for a in count]) + transformed(
            level["J"], level["i"], level["i"]
        )
        return symmetric(on_even_keel).middle[0], np.array(slopes).reshape(-1, caps, *n3).swapaxes(0, 1)

    @cached_property
    def magnitudes(self) -> tuple[Array, ...]:
        """|M^-1| and what it makes of the forces' magnitudes: D_signs, |Q| and Q_signs."""
        M = np.abs(self.inverse)
        forces = self.forces
        Q = np.abs(np.tensordot(self.inverse, forces.Q, 1))
        return M, M @ forces.D_signs, Q * (1 + PROOFS.room), np.tensordot(M, forces.Q_signs, 1)


def _largest(sizes: Array, caps: int) -> Array:
    """The largest over the boxes of each cap."""
    return np.asarray(sizes.reshape(caps, -1, *sizes.shape[1:]).max(axis=1))
