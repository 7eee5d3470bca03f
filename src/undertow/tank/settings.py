"""What a tank is: its rules, its cases, and the file `tank.toml` that states them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomlkit
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.interpolate import PchipInterpolator

from undertow.errors import UndertowError
from undertow.files import read_toml
from undertow.typing import Array

SCHEMA = "undertow/tank/1"
FILE = "tank.toml"
HULL = "hull.stl"


@dataclass(frozen=True)
class TankRules:
    """How water, grid and time follow from a hull and a speed; lengths are shares of its longest side."""

    reach: float = 3.0  # water between hull and outer boundary: it holds the added mass of a sphere to 0.3%
    # the same where the flow is plane and what a body moves fades more slowly: a cylinder to 0.3%
    plane: float = 12.0
    along: float = 20.0  # surface cells of the coarsest grid along the longest side, at least
    across: float = 8.0  # the same across the shortest side
    background: float = 5.0  # cells far away along the longest side, at least
    near: float = 0.1  # distance within which cells are as fine as at the surface
    # highest speed over sqrt(g depth) at which the surface stays flat: waves fade with depth as exp(-2/F^2)
    froude: float = 0.5
    around: float = 0.67  # distance within which they are twice as fine as far away
    # Layers at the hull, where its boundary layer is thinner than cells: without them drag is not that of the
    # wall, but of half a cell off it, and falls with every finer grid. They are the same on all grids: a wall
    # function is a model, and its answer depends on where its cell ends.
    wall: float = 30.0  # y+ of the middle of the first: where the law of the wall begins
    thinnest: float = 0.125  # of the first, in cells of the surface: thinner ones cannot follow a curved hull
    growth: float = 1.3  # thickness of one over that of the one below it
    layers: float = 1.0  # thickness of all, in cells of the surface
    # least share of the hull that layers cover: without any, drag was up to 40% off, a twentieth is 2%
    covered: float = 0.95
    refinement: float = 2**0.5  # ratio of cells, and of time steps, of one grid to the next finer one
    courant: float = 0.5  # surface cells that pass in one time step, at the speed asked for
    push_steps: int = 40  # time steps of a short push
    push: float = 0.02  # travel of a short push, of the length along the motion: no wake forms
    # travel of steps, at the highest speed: the drag settles at two speeds, or the hull speeds up, coasts and
    # is pushed back
    travel: float = 15.0
    sine: float = 0.5  # amplitude of a prescribed sine, of the length along the motion
    periods: int = 3  # of a sine; the first is left out
    ramp: float = 1.0  # travel while a prescribed speed changes: impulsive starts diverge
    force_ramp: float = 0.025  # travel while a force changes
    laminar_below: float = 4000.0  # Reynolds number below which no turbulence model is used
    intensity: float = 0.01  # of the turbulence in the water at rest, of the speed
    eddies: float = 10.0  # turbulent viscosity of the water at rest, of the laminar one
    relaxation: float = 0.75  # most that an acceleration changes in one correction of a free hull
    corrections: int = 3  # outer corrections of a time step
    same: float = 1e-5  # distance within which a mirrored corner is a corner: the hull is mirror-symmetric
    # most that the speed of a free hull may differ from that by the forces on it, of the highest: both are
    # iterated. Half a percent is usual; where it was 150%, forces jumped from step to step.
    apart: float = 0.05
    courant_limit: float = 50.0  # beyond it a run has diverged
    samples: int = 400  # of the table of a smooth signal
    reached: float = 1e-6  # share of a run that may lack at its end: times are rounded
    same_time: float = 1e-9  # s between times that are the same
    outputs: int = 20  # times at which a run that is cut off can be taken up again


RULES = TankRules()

Motion = Literal["surge", "sway", "heave", "roll", "pitch", "yaw"]
Axis = Literal["x", "y", "z"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Layers(_Strict):
    """Thin cells at the hull, the same on all grids."""

    first: float = Field(gt=0)  # thickness of the first, m
    growth: float = Field(gt=1)  # of one over that of the one below it
    count: int = Field(ge=1)


class Case(_Strict):
    """One motion of the hull, on all grids."""

    name: str = Field(pattern=r"^[a-z0-9-]+$")
    motion: Motion
    profile: str
    direction: Literal[-1, 1]
    prescribed: bool  # whether the motion is given and the force measured, or the other way round
    # Largest speed (m/s, rad/s) of a prescribed motion, force (N, N m) of a free one.
    peak: float = Field(gt=0)
    # Highest speed expected, m/s, of a turning hull at the ends of its longest side: how turbulent water is.
    speed: float = Field(default=0.3, gt=0)
    inertia: float = Field(gt=0)  # mass, kg, or moment of inertia, kg m^2, that goes with the motion
    end: float = Field(gt=0)  # s
    step: float = Field(gt=0)  # time step on the coarsest grid, s
    planes: tuple[Axis, ...]  # axes normal to the planes of symmetry at which the water is cut
    turbulent: bool
    layers: Layers | None = None  # None where the cells resolve the boundary layer
    relaxation: float = Field(gt=0, le=1)
    times: tuple[float, ...]  # of the signal, s
    signal: tuple[float, ...]  # speed or force at these times, over `peak`

    @property
    def copies(self) -> int:
        """How often the water that is computed makes up the whole."""
        return 2 ** len(self.planes)


class Tank(_Strict):
    """A hull, the water around it, and the cases: what `tank.toml` says."""

    schema_: Literal["undertow/tank/1"] = Field(alias="schema", default="undertow/tank/1")
    hull: str  # file it was made from
    sha256: str  # of that file
    mass: float = Field(gt=0)  # kg
    density: float = Field(gt=0)  # kg/m^3
    viscosity: float = Field(gt=0)  # kinematic, m^2/s
    half: tuple[float, float, float]  # half sides of the water, m
    cell: float = Field(gt=0)  # of the surface on the coarsest grid, m
    level: int = Field(ge=1, le=6)  # halvings from the cells far away to those at the surface
    size: float = Field(gt=0)  # longest side of the hull, m
    refinement: float = Field(gt=1)
    grids: int = Field(ge=1, le=4)
    symmetric: tuple[Axis, ...]  # axes along which the hull is its own mirror image
    span: Axis | None = None  # axis along which walls cut the hull: it is a piece of one without ends
    share: float = Field(default=1.0, gt=0, le=1)  # of the hull that is between these walls
    depth: float | None = Field(default=None, gt=0)  # of the centre below the surface, m; None: no surface
    cases: tuple[Case, ...] = Field(min_length=1)
    rules: dict[str, float] = {}  # `TankRules` that it was made by, for the record

    def cell_of(self, grid: int) -> float:
        """Size of the cells at the hull on a grid (1 is the coarsest), m."""
        return float(self.cell / self.refinement ** (grid - 1))

    def step_of(self, case: Case, grid: int) -> float:
        """Time step of a case on a grid, s: a whole number of them is the whole time."""
        wanted = case.step / self.refinement ** (grid - 1)
        return case.end / max(1, round(case.end / wanted))

    def text(self) -> str:
        """The content of `tank.toml`."""
        content = self.model_dump(by_alias=True, exclude={"rules"}, exclude_none=True, mode="json")
        heading = (
            "# A virtual towing tank, written by `undertow tank new`; `undertow tank run` computes it.\n"
        )
        return heading + tomlkit.dumps({"schema": content.pop("schema"), **content, "rules": asdict(RULES)})


def folder_of(root: Path, case: Case, grid: int) -> Path:
    """Where the OpenFOAM case of a grid stands."""
    return root / "cases" / case.name / f"grid{grid}"


def log_of(root: Path, case: Case, grid: int) -> Path:
    """Where its log stands."""
    return root / "logs" / f"{case.name}-grid{grid}.csv"


def read_tank(root: str | Path) -> Tank:
    """Read the `tank.toml` of a folder."""
    path = Path(root) / FILE
    if not path.is_file():
        raise UndertowError(f"{root}: no towing tank (no {FILE} in it): make one with undertow tank new")
    content: dict[str, Any] = read_toml(path, "towing tank")
    try:
        tank = Tank.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise UndertowError(
            f"{path}: {where}: {first['msg']}: write the tank again with undertow tank new"
        ) from error
    for case in tank.cases:
        later = all(b > a for a, b in pairwise(case.times))
        if len(case.times) != len(case.signal) or len(case.times) < 2 or not later:
            raise UndertowError(
                f"{path}: case {case.name}: times must increase, one for each value of signal"
            )
    return tank


# --- signals -------------------------------------------------------------------------------------------
PROFILES = ("paper", "step", "sine", "push")
# Times, s, and forces, N, of the mini-AUV paper as its Figure 3 shows them; it ends at 30 s.
_PAPER = ((0.65, 0.32), (18.45, -0.48), (21.95, 0.22))
_PAPER_END, _PAPER_PEAK = 30.0, 0.48


def duration(profile: str, scale: float) -> float:
    """How long a profile lasts, s; `scale` is the time in which the hull travels its length, s."""
    if profile == "push":
        return 2 * RULES.push * scale
    if profile == "paper":
        return _PAPER_END
    if profile == "sine":
        return RULES.periods * 2 * np.pi * RULES.sine * scale
    return RULES.travel * scale


def signal(profile: str, prescribed: bool, end: float, scale: float) -> tuple[Array, Array]:
    """Times, s, and values from -1 to 1 of a profile, at rest before it; in between it is linear.

    `scale`: time in which the hull travels its length, s.
    """
    ramp = (RULES.ramp if prescribed else RULES.force_ramp) * scale
    times = np.linspace(0.0, end, RULES.samples + 1)
    if profile == "push":
        # The hull is at rest again at the end either way: then drag does not pass for added mass.
        return times, np.sin(np.pi * times / end) ** 2 if prescribed else np.sin(2 * np.pi * times / end)
    if profile == "sine":
        period = end / RULES.periods
        return times, np.sin(2 * np.pi * times / period) * _smooth(2 * times / period)
    if profile == "paper":
        return _levels([(t, f / _PAPER_PEAK) for t, f in _PAPER], ramp, end, prescribed)
    if prescribed:
        return _levels([(0.0, 0.5), (2 / 3 * end, 1.0)], ramp, end, prescribed)
    return _levels([(0.0, 1.0), (end / 3, 0.0), (2 * end / 3, -1.0)], ramp, end, prescribed)


def _smooth(share: Array) -> Array:
    """From 0 to 1 with no jump of the slope."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s * s * (3 - 2 * s))


def _levels(levels: list[tuple[float, float]], ramp: float, end: float, smooth: bool) -> tuple[Array, Array]:
    """A signal that goes from one level to the next; forces may have corners, speeds may not."""
    count = RULES.samples if smooth else 2
    edges = [np.linspace(t, t + ramp, count) for t, _ in levels]
    times = np.unique(np.concatenate([[0.0], *edges, [end]]))
    values, before = np.zeros_like(times), 0.0
    for t, level in levels:
        share = (times - t) / ramp
        values += (level - before) * (_smooth(share) if smooth else np.clip(share, 0.0, 1.0))
        before = level
    kept = times <= end
    return times[kept], values[kept]


def read_signal(path: Path) -> tuple[Array, Array]:
    """A user's signal: a CSV file with time, s, and speed or force in SI units, with or without a head."""
    try:
        rows = np.genfromtxt(path, delimiter=",", comments="#", invalid_raise=True)
    except (OSError, ValueError) as error:
        raise UndertowError(
            f"profile {path}: neither {', '.join(PROFILES)} nor a CSV file that can be read: give one with "
            "two columns, time and speed or force"
        ) from error
    rows = np.atleast_2d(rows)
    rows = rows[1:] if np.isnan(rows[0]).all() else rows
    if rows.shape[1] != 2 or len(rows) < 2 or not np.isfinite(rows).all():
        raise UndertowError(
            f"profile {path}: needs two columns of numbers (time, value) and two rows at least"
        )
    times, values = rows.T
    if not (np.diff(times) > 0).all() or times[0] < 0 or not np.abs(values).max() > 0:
        raise UndertowError(f"profile {path}: times must increase from 0, and some value must differ from 0")
    return (times, values) if times[0] == 0 else (np.r_[0.0, times], np.r_[0.0, values])


def motion(times: Array, speeds: Array, at: Array) -> Array:
    """Place, speed and acceleration, shape (3, n), of a speed that is given at times, at other times."""
    # Monotone between the points: a spline would overshoot where a long even segment begins.
    speed = PchipInterpolator(times, speeds)
    return np.array([speed.antiderivative()(at), speed(at), speed.derivative()(at)])
