"""Added mass and damping out of the logs of a tank, with errors of the fit and of the grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from undertow.errors import UndertowError
from undertow.model.symbols import DOFS, FORCE, VELOCITY
from undertow.typing import Array, Flags

from .convergence import Convergence, convergence
from .records import Record, read_record
from .settings import RULES, Case, Tank, log_of


@dataclass(frozen=True)
class FitRules:
    """What of a log says how much."""

    settled: float = 3.0  # lengths travelled at one speed until the drag counts as steady
    even: float = 0.01  # share by which a speed may change in that time
    # share that grids do not show: the boundary of the water, time steps within a push (docs/tank.md)
    model: float = 0.02
    rows: int = 6  # fewest samples that say something of damping
    band: float = 2.0  # a grid convergence index is a band of so many standard deviations


_RULES = FitRules()


# Effects of a vehicle file by what marks their names, and the units of force and of moment coefficients.
EFFECTS = {
    "added_mass": ("dot", "kg", "kg m^2"),
    "quadratic_damping": ("abs", "kg/m", "kg m^2"),
    "linear_damping": ("", "kg/s", "kg m^2/s"),
}


@dataclass(frozen=True)
class Coefficient:
    """An added mass or damping coefficient, positive as it resists."""

    name: str  # SNAME derivative that is minus this, such as X_udot
    motion: str
    direction: int  # 1 forward, -1 backward, 0 both
    fit: float  # standard error of the least squares on the finest grid
    grid: Convergence
    source: str

    @property
    def value(self) -> float:
        """On the finest grid, in SI units."""
        return self.grid.value

    @property
    def effect(self) -> str:
        """Its effect in a vehicle file."""
        return next(effect for effect, (mark, *_) in EFFECTS.items() if mark in self.name)

    @property
    def unit(self) -> str:
        """Of its value."""
        return EFFECTS[self.effect][1 + (DOFS.index(self.motion) > 2)]

    @property
    def way(self) -> str:
        """Its direction in words."""
        return {0: "both", 1: "forward", -1: "backward"}[self.direction]

    @property
    def sigma(self) -> float:
        """Standard deviation: of the fit, of the grid, and of what grids do not show."""
        parts = [self.fit, self.grid.index / _RULES.band, _RULES.model * self.value]
        return float(np.linalg.norm(parts))


def coefficients(root: Path, tank: Tank) -> list[Coefficient]:
    """Coefficients of every motion and direction that has logs.

    A grid counts for a motion and a direction when all cases that say something of it are done on it.
    """
    found: list[Coefficient] = []
    for motion in dict.fromkeys(case.motion for case in tank.cases):
        cases = [case for case in tank.cases if case.motion == motion]
        two_sided = any(case.direction < 0 for case in cases)
        for direction in (1, -1) if two_sided else (0,):
            found += _of_motion(root, tank, [c for c in cases if _tells(c, direction)], direction)
    if not found:
        raise UndertowError(f"{root}: no logs yet: undertow tank run {root} makes them")
    return found


def _tells(case: Case, direction: int) -> bool:
    """Whether a case says something of a direction: pushes and prescribed steps go one way only."""
    one_way = case.profile == "push" or (case.profile == "step" and case.prescribed)
    return direction * case.direction >= 0 or not one_way


def _of_motion(root: Path, tank: Tank, cases: Sequence[Case], direction: int) -> list[Coefficient]:
    done = [g for g in range(tank.grids, 0, -1) if all(log_of(root, c, g).is_file() for c in cases)]
    if not cases or not done:
        return []
    fits = []
    for grid in done:
        records = [(case, read_record(log_of(root, case, grid), grid)) for case in cases]
        fits.append(_fit(tank, records, direction))
    place = DOFS.index(cases[0].motion)
    force, speed = FORCE[place], VELOCITY[place]
    names = {"a": f"{force}_{speed}dot", "d": f"{force}_{speed}", "q": f"{force}_{speed}abs{speed}"}
    kind = "prescribed motion" if cases[0].prescribed else "given force"
    sizes = [tank.cell_of(g) for g in done]
    profiles = ", ".join(dict.fromkeys(c.profile for c in cases))
    source = f"virtual towing tank, {kind}, {profiles}, {len(done)} grid(s)"
    return [
        Coefficient(
            names[key],
            cases[0].motion,
            direction,
            fits[0][key][1],
            convergence([f[key][0] for f in fits], sizes),
            source,
        )
        for key in fits[0]
    ]


Fit = dict[str, tuple[float, float]]


def _fit(tank: Tank, records: Sequence[tuple[Case, Record]], direction: int) -> Fit:
    """Value and standard error of a (added mass), d and q (linear and quadratic damping) on one grid."""
    result: Fit = {}
    pushes = [r for c, r in records if c.profile == "push"]
    others = [(r, _length(tank, c)) for c, r in records if c.profile != "push"]
    if pushes:
        result["a"] = _by_pushes(pushes)
    if others:
        result |= _by_balance(others, direction, result.get("a"))
    return result


def _by_pushes(pushes: Sequence[Record]) -> tuple[float, float]:
    """Added mass by the momentum that the water has taken up.

    Integrals of force are used because a lag of a fraction of a time step between force and acceleration,
    which every scheme has, would pass for damping; a constant takes up what the first steps from rest miss.
    """
    rows, taken = [], []
    for r in pushes:
        step = np.diff(r.time, prepend=0.0)
        rows.append(np.column_stack([r.speed, np.cumsum(r.speed * step), np.ones(len(step))]))
        taken.append(-np.cumsum(r.water * step))
    values, errors = least_squares(np.concatenate(rows), np.concatenate(taken))
    return float(values[0]), float(errors[0])


def _by_balance(
    records: Sequence[tuple[Record, float]], direction: int, known: tuple[float, float] | None
) -> Fit:
    """Damping, and added mass where no push says it, from the balance of forces at every time step."""
    columns, forces = [], []
    for r, length in records:
        settled = _settled(r, length)
        kept = settled if known and settled.sum() >= _RULES.rows else np.ones_like(settled)
        kept = kept & (r.speed * direction > 0) if direction else kept
        u = r.speed[kept]
        columns.append(np.column_stack([r.acceleration[kept], u, np.abs(u) * u]))
        forces.append(-r.water[kept])
    table, force = np.concatenate(columns), np.concatenate(forces)
    if len(table) < _RULES.rows:
        raise UndertowError(
            f"{len(table)} samples are too few for damping: choose a longer profile such as step"
        )
    if known:
        values, errors = least_squares(table[:, 1:], force - known[0] * table[:, 0], positive=True)
        return dict(zip("dq", zip(values.tolist(), errors.tolist(), strict=True), strict=True))
    values, errors = least_squares(table, force, positive=True)
    return dict(zip("adq", zip(values.tolist(), errors.tolist(), strict=True), strict=True))


def _length(tank: Tank, case: Case) -> float:
    """Of the hull along a motion, m: steps of speed go so many of them."""
    return case.end * case.speed / RULES.travel if case.prescribed and case.profile == "step" else tank.size


def _settled(record: Record, length: float) -> Flags:
    """Rows at which the hull has gone `FitRules.settled` lengths at one speed, shape (n,)."""
    speed = np.abs(record.speed)
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(record.time))])
    before = np.interp(way - _RULES.settled * length, way, record.speed)
    return np.asarray(
        (np.abs(record.speed - before) <= _RULES.even * speed) & (way >= _RULES.settled * length)
    )


def least_squares(table: Array, values: Array, *, positive: bool = False) -> tuple[Array, Array]:
    """Coefficients and their standard errors, both shape (k,), of a linear model.

    `positive` keeps coefficients from 0 on: a damping that drives the hull is none. Errors are those of
    residuals that follow each other with the correlation they show from one row to the next.
    """
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0] = 1.0
    scaled = table / scale
    found = nnls(scaled, values)[0] if positive else np.linalg.lstsq(scaled, values, rcond=None)[0]
    rest = values - scaled @ found
    free = max(len(values) - len(found), 1)
    follow = float(np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300), 0.0, 0.99))
    variance = rest @ rest / free * (1 + follow) / (1 - follow)
    return found / scale, np.sqrt(variance * np.diag(np.linalg.pinv(scaled.T @ scaled))) / scale
