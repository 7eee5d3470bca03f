"""Added mass and damping out of the logs of a tank, with errors of the fit and of the grid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from math import copysign, log
from pathlib import Path

import numpy as np
import tomlkit
from scipy.optimize import nnls

from undertow.errors import UndertowError
from undertow.files import read_toml, together, write_whole
from undertow.identification.logs.mapping import SCHEMA
from undertow.model.symbols import DOFS, FORCE, POSE, VELOCITY
from undertow.shape.hull_vehicle import EffectTable, entry_line, vehicle_text
from undertow.typing import Array

from .settings import RULES, Case, Tank, log_of


class TooLittleMotion(UndertowError):
    """Logs in which a hull hardly moved in a direction."""


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

    A grid counts for a motion and a direction when all cases that say something of it are done on it. A
    direction in which a hull hardly went is left out where others tell something.
    """
    found: list[Coefficient] = []
    short: UndertowError | None = None
    for motion in dict.fromkeys(case.motion for case in tank.cases):
        cases = [case for case in tank.cases if case.motion == motion]
        two_sided = any(case.direction < 0 for case in cases)
        for direction in (1, -1) if two_sided else (0,):
            try:
                found += _of_motion(root, tank, [c for c in cases if _informs(c, direction)], direction)
            except TooLittleMotion as error:
                short = error
    if short and not found:
        raise short
    if not found:
        raise UndertowError(f"{root}: no logs yet: undertow tank run {root} makes them")
    return found


def _informs(case: Case, direction: int) -> bool:
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
            convergence([f[key][0] for f in fits], sizes, drag=key != "a"),
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
        # Rows at which the hull has gone some lengths (`FitRules.settled`) at one speed, shape (n,).
        speed = np.abs(r.speed)
        way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(r.time))])
        before = np.interp(way - _RULES.settled * length, way, r.speed)
        settled = np.asarray(
            (np.abs(r.speed - before) <= _RULES.even * speed) & (way >= _RULES.settled * length)
        )
        kept = settled if known and settled.sum() >= _RULES.rows else np.ones_like(settled)
        kept = kept & (r.speed * direction > 0) if direction else kept
        u = r.speed[kept]
        columns.append(np.column_stack([r.acceleration[kept], u, np.abs(u) * u]))
        forces.append(-r.water[kept])
    table, force = np.concatenate(columns), np.concatenate(forces)
    if len(table) < _RULES.rows:
        raise TooLittleMotion(
            f"{len(table)} samples are too few for damping: choose a longer profile such as step"
        )
    if known:
        values, errors = least_squares(table[:, 1:], force - known[0] * table[:, 0], positive=True)
        return dict(zip("dq", zip(values.tolist(), errors.tolist(), strict=True), strict=True))
    values, errors = least_squares(table, force, positive=True)
    return dict(zip("adq", zip(values.tolist(), errors.tolist(), strict=True), strict=True))


def _length(tank: Tank, case: Case) -> float:
    """Of the hull along a motion, m; of a turn, the angle in which its ends go as far as it is long, rad."""
    if case.prescribed and case.profile == "step":
        return case.end * case.peak / RULES.travel
    return 2.0 if DOFS.index(case.motion) > 2 else tank.size


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


# --- logs ----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Record:
    """What happened in one case on one grid; all arrays have shape (n,), SI units, along the motion."""

    time: Array  # s
    push: Array  # force or moment on the hull from outside, N or N m
    place: Array  # m or rad
    speed: Array  # m/s or rad/s
    acceleration: Array  # m/s^2 or rad/s^2: by Newton from the forces where the hull is free
    water: Array  # force or moment of the water on the hull, N or N m
    grid: int
    cells: int
    seconds: float  # of one processor that the solver took


def columns(motion: str) -> tuple[str, ...]:
    """Names of the columns of a log, with units."""
    turns = DOFS.index(motion) > 2
    force, angle = ("moment", "rad") if turns else ("force", "m")
    unit = "Nm" if turns else "N"
    return (
        "t_s",
        f"applied_{force}_{unit}",
        f"place_{angle}",
        f"speed_{angle}_s",
        f"acceleration_{angle}_s2",
        f"water_{force}_{unit}",
    )


def write_record(path: Path, record: Record, tank: Tank, case: Case) -> None:
    """Write a log and, beside it, its mapping file with the grid and the settings of the solver."""
    table = np.column_stack(
        [record.time, record.push, record.place, record.speed, record.acceleration, record.water]
    )
    text = StringIO()
    np.savetxt(text, table, fmt="%.9g", delimiter=",", header=",".join(columns(case.motion)), comments="")
    with together():
        write_whole(path, text.getvalue())
        write_whole(path.with_suffix(".toml"), _mapping(record, tank, case))


def _mapping(record: Record, tank: Tank, case: Case) -> str:
    place = DOFS.index(case.motion)
    turns = place > 2
    names = columns(case.motion)
    kind = "prescribed motion, force measured" if case.prescribed else "force given, one motion free"
    flow = "k-omega SST with wall functions" if case.turbulent else "laminar"
    lines = (
        f"Virtual towing tank: {case.name} of {tank.hull}; {kind}; no measurement noise.",
        f"grid {record.grid}: {record.cells} cells, {tank.cell_of(record.grid):.4g} m at the hull, "
        f"{case.copies} times mirrored",
        f"OpenFOAM pimpleFoam, {flow}, time step {tank.step_of(case, record.grid):.4g} s, "
        f"{record.seconds:.0f} s of a processor",
    )
    mark = "rad" if turns else "m"
    mapping = {
        "schema": SCHEMA,
        "description": f"Towing tank, {case.name}, grid {record.grid} of {record.cells} cells; {flow}",
        "ignore": list(names[4:]),
        "held": "unlogged",
        "time": {"column": names[0], "unit": "s"},
        "columns": {
            names[1]: {"channel": f"tau_{FORCE[place]}", "unit": "N m" if turns else "N"},
            names[2]: {"channel": POSE[place], "unit": mark},
            names[3]: {"channel": VELOCITY[place], "unit": f"{mark}/s"},
        },
    }
    return "".join(f"# {line}\n" for line in lines) + tomlkit.dumps(mapping)


def read_record(path: Path, grid: int) -> Record:
    """Read a log of the tank."""
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError) as error:
        raise UndertowError(
            f"{path}: not a log of the tank ({error}): remove it and run the tank again"
        ) from error
    if table.shape[1] != 6 or len(table) < 4:
        raise UndertowError(f"{path}: not a log of the tank (six columns): remove it and run the tank again")
    description = str(read_toml(path.with_suffix(".toml"), "mapping file").get("description", ""))
    digits = description.rpartition(" of ")[2].split(" cells")[0]
    cells = int(digits) if digits.isdigit() else 0
    t, push, place, speed, acceleration, water = table.T
    return Record(t, push, place, speed, acceleration, water, grid, cells, 0.0)


# --- a vehicle file ------------------------------------------------------------------------------------
def tank_vehicle(tank: Tank, found: Sequence[Coefficient], name: str) -> str:
    """The text of a vehicle file with the motions that were tested.

    Mass and moments of inertia are those of the tank; values of both directions stand in it where the hull
    was tested in both.
    """
    motions = tuple(d for d in DOFS if any(c.motion == d for c in found))
    turns = [EffectTable("rigid_body_coriolis", []), EffectTable("added_mass_coriolis", [])]
    tables = [EffectTable("rigid_body", list(_rigid_body(tank, motions))), *tested(found)]
    return vehicle_text(
        made_from=f"a virtual towing tank with {tank.hull} (sha256 {tank.sha256})",
        about=[
            "The hull was moved in one motion at a time: couplings between motions were not tested.",
            "Weight and buoyancy are taken as equal; thrusters and all other forces are missing.",
        ],
        name=name,
        description=f"{name} as tested in a virtual towing tank, {', '.join(motions)}",
        source=f"virtual towing tank, {tank.hull}",
        degrees_of_freedom=motions,
        density=tank.density,
        tables=[t for t in tables if t.entries] + (turns if len(motions) > 1 else []),
    )


def tested(found: Sequence[Coefficient]) -> list[EffectTable]:
    """Added mass and damping that were found, one table for each effect."""
    return [EffectTable(effect, list(_entries(found, effect))) for effect in EFFECTS]


def _rigid_body(tank: Tank, motions: Sequence[str]) -> Iterator[str]:
    yield entry_line("m", tank.mass, "kg", source="as stated")
    for motion, axis in (("roll", "x"), ("pitch", "y"), ("yaw", "z")):
        if motion in motions:
            inertia = next(case.inertia for case in tank.cases if case.motion == motion)
            yield entry_line(f"I_{axis}", inertia, "kg m^2", source="as in the tank")


def _entries(found: Sequence[Coefficient], effect: str) -> Iterator[str]:
    own = [c for c in found if c.effect == effect]
    for name in dict.fromkeys(c.name for c in own):
        first, *others = [c for c in own if c.name == name]
        yield entry_line(
            name,
            -first.value,
            first.unit,
            backward=-others[0].value if others else None,
            sigma=max(c.sigma for c in (first, *others)),
            estimate=True,
            source=first.source + (f"; {first.way} only" if first.direction and not others else ""),
        )


# --- what the grid leaves open -------------------------------------------------------------------------
@dataclass(frozen=True)
class GciRules:
    """How a grid convergence index is computed; factors are those of Roache."""

    three: float = 1.25  # factor of safety where three grids show the order
    two: float = 3.0  # the same where the order is assumed
    assumed: float = 1.0  # order where it is: limiters and turbulence are of first order
    least: float = 0.5  # a lower observed order would make the index grow without bound
    most: float = 2.0  # the schemes have no higher order; a higher observed one is chance
    one: float = 0.10  # share of an added mass that a single grid leaves open
    one_of_drag: float = 0.8  # the same of a damping: the coarsest grid of a slender hull was 40% too high
    rounds: int = 50  # of the iteration for the order
    ceiling: float = 20.0  # of the observed order: values that agree to rounding have any


CONVERGENCE = GciRules()


@dataclass(frozen=True)
class Convergence:
    """How far a value is from that of an infinitely fine grid."""

    value: float  # on the finest grid
    extrapolated: float  # by Richardson; the value itself where it does not converge
    order: float  # as observed, or assumed; 0 where values run apart
    index: float  # grid convergence index of the finest grid times the value: a band of about 95%
    kind: str  # "monotone", "oscillating", "running apart", "two grids", "one grid"


def observed_order(values: Sequence[float], sizes: Sequence[float]) -> float:
    """Order of convergence of three values, finest grid first, by the fixed-point iteration of Celik et al.

    `sizes`: of their cells, rising. Source: Celik et al. (2008), Procedure for estimation and reporting of
    uncertainty due to discretization in CFD applications, J. Fluids Eng. 130, 078001. At most 20, also
    if the two finer values agree.
    """
    one, two = values[1] - values[0], values[2] - values[1]
    if not one:
        return CONVERGENCE.ceiling
    if not two:
        return 0.0
    fine, coarse = sizes[1] / sizes[0], sizes[2] / sizes[1]
    sign, order = copysign(1.0, two / one), 1.0
    for _ in range(CONVERGENCE.rounds):
        uneven = (fine**order - sign) / (coarse**order - sign)
        order = min(abs(log(abs(two / one)) + log(uneven)) / log(fine), CONVERGENCE.ceiling) or 1e-9
    return order


def convergence(values: Sequence[float], sizes: Sequence[float], *, drag: bool = False) -> Convergence:
    """Richardson extrapolation and grid convergence index (Roache) of values on grids, finest first.

    `values`: of one to four grids, of which the three finest count; `sizes`: of their cells, rising; `drag`:
    whether they are of a damping, of which a single grid says less. Where values run apart the index is three
    times their spread. Source: Roache (1994), Perspective: a method for uniform reporting of grid refinement
    studies, J. Fluids Eng. 116, 405-413.
    """
    if not values or len(values) != len(sizes) or any(b <= a for a, b in pairwise(sizes)):
        raise UndertowError("grid convergence: give a value for each grid, finest first, with rising sizes")
    value = values[0]
    if len(values) == 1:
        share = CONVERGENCE.one_of_drag if drag else CONVERGENCE.one
        return Convergence(value, value, 0.0, share * abs(value), "one grid")
    change, ratio = value - values[1], sizes[1] / sizes[0]
    if len(values) == 2:
        step = change / (ratio**CONVERGENCE.assumed - 1)
        return Convergence(value, value + step, CONVERGENCE.assumed, CONVERGENCE.two * abs(step), "two grids")
    order = observed_order(values[:3], sizes[:3])
    before = values[1] - values[2]
    if abs(change) >= abs(before) and change:
        spread = max(values[:3]) - min(values[:3])
        return Convergence(value, value, 0.0, CONVERGENCE.two * spread, "running apart")
    used = min(max(order, CONVERGENCE.least), CONVERGENCE.most)
    step = change / (ratio**used - 1)
    if change * before < 0:
        spread = max(values[:3]) - min(values[:3])
        return Convergence(value, value, order, max(CONVERGENCE.three * abs(step), spread / 2), "oscillating")
    return Convergence(value, value + step, order, CONVERGENCE.three * abs(step), "monotone")
