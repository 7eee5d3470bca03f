"""OpenFOAM cases: from a hull to the water around it, and from that to the files of every case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Template
from scipy.spatial import cKDTree

from undertow.errors import UndertowError
from undertow.files import make_folder, templates, together, write_whole
from undertow.model.symbols import DOFS, ENVIRONMENT
from undertow.shape.bodies import equivalent
from undertow.shape.hull_vehicle import drag_of_hull
from undertow.shape.mesh import Mesh, stl_bytes
from undertow.typing import Array

from .settings import (
    FILE,
    HULL,
    PROFILES,
    RULES,
    Case,
    Layers,
    Tank,
    duration,
    folder_of,
    motion,
    read_signal,
    signal,
)

_AXES = ("x", "y", "z")
# The plane that shows most of each motion, by its normal: 0, 1, 2 for x, y, z.
SECTION_AXES = {"surge": 1, "sway": 2, "heave": 1, "roll": 0, "pitch": 1, "yaw": 2}
_ALWAYS = (
    "system/blockMeshDict",
    "system/surfaceFeatureExtractDict",
    "system/snappyHexMeshDict",
    "system/controlDict",
    "system/fvSchemes",
    "system/fvSolution",
    "system/decomposeParDict",
    "constant/dynamicMeshDict",
    "constant/transportProperties",
    "constant/turbulenceProperties",
    "0/U",
    "0/p",
)


@dataclass(frozen=True)
class TankPlan:
    """What is to be done in the tank."""

    mass: float  # kg
    motions: Sequence[str] = ("surge",)
    profiles: Sequence[str] = ("push", "step")  # names, or CSV files
    prescribed: bool = False  # whether motions are given and forces measured
    speed: float = 0.3  # highest, m/s; a turning hull has it at the ends of its longest side
    force: float | None = None  # highest, N or N m; None: what keeps `speed` up by the drag of the form
    inertia: float | None = None  # of turning, kg m^2; None: mass spread evenly over the hull
    density: float = 1000.0  # kg/m^3
    viscosity: float = 1e-6  # m^2/s
    turbulence: str = "auto"  # laminar, k-omega-sst, or auto: by the Reynolds number
    grids: int = 3
    step: float = 1.0  # time steps, as a share of those of the rules
    depth: float | None = None  # of the centre of volume below the surface, m; None: deeply submerged
    span: str | None = None  # x, y or z: the hull is taken for a piece of one without ends along it


def make_tank(hull: Mesh, plan: TankPlan, name: str, sha256: str) -> tuple[Tank, Mesh]:
    """A tank for a hull, and the hull with its centre of volume in the origin."""
    _check(plan)
    centred = hull.moved(-hull.centroid)
    rules = RULES
    sizes = _across(centred, plan)
    longest, cell = float(sizes.max()), _cell(sizes)
    if plan.depth is not None:
        _check_depth(plan, plan.depth, -float(centred.bounds[0][2]) + cell)
    level = max(1, int(np.floor(np.log2(longest / rules.background / cell) + 1e-9)))
    background = cell * 2**level
    reach = np.abs(centred.bounds).max(axis=0) + (rules.reach if plan.span is None else rules.plane) * longest
    half = np.ceil(reach / background) * background
    if plan.span is not None:
        half[_AXES.index(plan.span)] = background / 2
    x, y, z = (float(r) for r in half)
    # A surface leaves no symmetry of up and down.
    symmetric = [i for i in _symmetries(centred) if plan.depth is None or i < 2]
    added = np.diag(equivalent(centred, plan.density).matrix)
    form = np.array([added, drag_of_hull(centred, plan.density).coefficients])
    cases = [
        case
        for motion_name in plan.motions
        for profile in plan.profiles
        for case in _cases(centred, form, plan, motion_name, profile, symmetric)
    ]
    if plan.depth is not None:
        _check_waves(cases, plan.depth)
    tank = Tank(
        hull=name,
        sha256=sha256,
        mass=plan.mass,
        density=plan.density,
        viscosity=plan.viscosity,
        half=(x, y, z),
        cell=cell,
        level=level,
        size=longest,
        refinement=rules.refinement,
        grids=plan.grids,
        symmetric=tuple(_AXES[i] for i in symmetric),  # type: ignore[misc]
        depth=plan.depth,
        span=plan.span,  # type: ignore[arg-type]
        share=1.0 if plan.span is None else background / float(centred.extents[_AXES.index(plan.span)]),
        cases=tuple(cases),
    )
    return tank, centred


def _check(plan: TankPlan) -> None:
    numbers = {
        "mass": (plan.mass, "kg"),
        "speed": (plan.speed, "m/s"),
        "density": (plan.density, "kg/m^3"),
        "viscosity": (plan.viscosity, "m^2/s"),
        "force": (1.0 if plan.force is None else plan.force, "N or N m"),
        "inertia": (1.0 if plan.inertia is None else plan.inertia, "kg m^2"),
        "time step": (plan.step, "of the usual one"),
    }
    for what, (value, unit) in numbers.items():
        if not (value > 0 and np.isfinite(value)):
            raise UndertowError(f"{what} = {value:g} {unit}: give a positive number")
    if not 1 <= plan.grids <= 4:
        raise UndertowError(f"--grids {plan.grids}: give 1 to 4")
    if plan.span is not None and plan.span not in _AXES:
        raise UndertowError(f"--span {plan.span} is not an axis: choose x, y or z")
    wrong = [m for m in plan.motions if plan.span and not _in_plane(m, plan.span)]
    if wrong:
        raise UndertowError(
            f"{wrong[0]} is not in the plane normal to --span {plan.span}: choose another motion"
        )
    if plan.prescribed and "paper" in plan.profiles:
        raise UndertowError(
            "profile paper is a series of forces: leave out --prescribed, or choose push, step or sine"
        )


def _check_depth(plan: TankPlan, depth: float, least: float) -> None:
    """`least`: depth at which one cell of water is left above the hull, m."""
    if not least <= depth < np.inf:
        raise UndertowError(
            f"--depth {depth:g} m: at least {least:.3g} m keep this hull and a cell above it under "
            "water: for a hull at the surface use undertow vehicle new --floating"
        )
    rising = [m for m in plan.motions if m in ("heave", "roll", "pitch")]
    if plan.span == "z" or (rising and set(plan.profiles) != {"push"}):
        what = "--span z" if plan.span == "z" else f"longer {rising[0]} than a push"
        raise UndertowError(f"--depth: {what} would leave the water: leave it out, or leave out --depth")


def _check_waves(cases: Sequence[Case], depth: float) -> None:
    slow = RULES.froude * float(np.sqrt(ENVIRONMENT.gravity * depth))
    quick = [c for c in cases if c.profile != "push" and c.speed > slow]
    if quick:
        raise UndertowError(
            f"{quick[0].name} at {quick[0].speed:.3g} m/s makes waves at a depth of {depth:g} m, which the "
            f"tank does not model: stay below {slow:.3g} m/s (--speed), or give --profile push"
        )


def _in_plane(motion_name: str, span: str) -> bool:
    place = DOFS.index(motion_name)
    return (place % 3 == _AXES.index(span)) == (place > 2)


def _across(hull: Mesh, plan: TankPlan) -> Array:
    """Sides of the hull, without the one along its span, m."""
    sides = hull.extents
    return sides if plan.span is None else np.delete(sides, _AXES.index(plan.span))


def _symmetries(hull: Mesh) -> list[int]:
    """Axes along which the hull is its own mirror image, corner by corner."""
    corners, near = cKDTree(hull.vertices), RULES.same * float(hull.extents.max())
    mirrored = {i: hull.vertices * (1 - 2 * (np.arange(3) == i)) for i in range(3)}
    return [i for i, points in mirrored.items() if float(corners.query(points)[0].max()) <= near]


def _cases(
    hull: Mesh, form: Array, plan: TankPlan, name: str, profile: str, symmetric: list[int]
) -> list[Case]:
    """A case, or two where both directions are not alike; `form` (2, 6) is added mass and drag by form."""
    turns, axis = DOFS.index(name) > 2, DOFS.index(name) % 3
    alike = any((i == axis) != turns for i in symmetric)
    both = profile in PROFILES and profile != "sine" and not alike
    label = f"{name}-{profile if profile in PROFILES else Path(profile).stem.lower()}"
    shared = _case(hull, form, plan, name, profile)
    shared["planes"] = tuple(_AXES[i] for i in symmetric if (i == axis) == turns and _AXES[i] != plan.span)
    values = np.array(shared.pop("signal"))
    return [
        Case(
            name=_plain(label + (("-forward" if way > 0 else "-backward") if both else "")),
            direction=way,  # type: ignore[arg-type]
            signal=tuple(np.round(way * values, 9).tolist()),
            **shared,
        )
        for way in ((1, -1) if both else (1,))
    ]


def _case(hull: Mesh, form: Array, plan: TankPlan, name: str, profile: str) -> dict[str, Any]:
    """What both directions of a case have in common: its signal, how strong it is, the time step."""
    place = DOFS.index(name)
    turns, sizes = place > 2, hull.extents
    longest = float(_across(hull, plan).max())
    arm = longest / 2 if turns else 1.0
    rate = plan.speed / arm  # m/s or rad/s
    scale = (longest if turns else float(sizes[place])) / plan.speed
    times, values, peak = _signal(profile, plan.prescribed, scale)
    inertia = plan.mass
    if turns:
        inertia = plan.inertia or float(hull.inertia[place - 3, place - 3]) * plan.mass / hull.volume
    added, drag = form[:, place].tolist()
    if peak is None:
        peak = rate if plan.prescribed else plan.force or drag * rate**2
        if profile == "push" and not plan.prescribed and plan.force is None:
            peak = np.pi * float(inertia + added) * rate / float(times[-1])
    push = profile == "push"
    reached = peak if plan.prescribed else max(rate, 0.0 if push else (peak / drag) ** 0.5)
    cell = _cell(_across(hull, plan))
    step = times[-1] / RULES.push_steps if push else RULES.courant * cell / (reached * arm)
    reynolds = reached * arm * longest / plan.viscosity
    auto = not push and reynolds > RULES.laminar_below
    turbulent = auto if plan.turbulence == "auto" else plan.turbulence == "k-omega-sst"
    return {
        "motion": name,
        "profile": profile if profile in PROFILES else "table",
        "prescribed": plan.prescribed,
        "peak": peak,
        "speed": float(reached * arm),
        "inertia": inertia,
        "end": float(times[-1]),
        "step": float(step * plan.step),
        "turbulent": turbulent,
        "layers": None if push else _layers(reynolds, longest, cell),
        "relaxation": min(RULES.relaxation, 1 / (1 + added / inertia)),
        "times": tuple(np.round(times, 9).tolist()),
        "signal": values,
    }


def _layers(reynolds: float, length: float, cell: float) -> Layers | None:
    """Layers from the wall, at the friction of a plate, to the cells of the hull, m; None in slow flow."""
    # Plates by Blasius and by the ITTC (1957): the larger friction has the thinner first layer.
    friction = max(1.328 / reynolds**0.5, 0.075 / max(np.log10(reynolds) - 2, 1.0) ** 2)
    first = max(2 * RULES.wall * length / reynolds / (friction / 2) ** 0.5, RULES.thinnest * cell)
    growth = RULES.growth
    count = round(float(np.log(1 + RULES.layers * cell * (growth - 1) / first) / np.log(growth)))
    return Layers(first=first, growth=growth, count=count) if count > 1 else None


def _signal(profile: str, prescribed: bool, scale: float) -> tuple[Array, Array, float | None]:
    """Times, values from -1 to 1, and the largest value where a file says it."""
    if profile in PROFILES:
        return *signal(profile, prescribed, duration(profile, scale), scale), None
    times, values = read_signal(Path(profile))
    peak = float(np.abs(values).max())
    return times, values / peak, peak


def _cell(sides: Array) -> float:
    """Size of the cells at a hull with these sides on the coarsest grid, m."""
    return float(min(sides.max() / RULES.along, sides.min() / RULES.across))


def _plain(label: str) -> str:
    return "".join(c if c.isalnum() and c.isascii() else "-" for c in label)


def write_tank(root: Path, tank: Tank, hull: Mesh) -> None:
    """Write the tank and all files of its cases, all or none."""
    with together():
        make_folder(root / "logs")
        write_whole(root / FILE, tank.text())
        write_whole(root / HULL, stl_bytes(hull))
        for case, grid in product(tank.cases, range(1, tank.grids + 1)):
            folder = folder_of(root, case, grid)
            for name, text in case_files(tank, case, grid).items():
                make_folder((folder / name).parent)
                write_whole(folder / name, text)


def case_files(tank: Tank, case: Case, grid: int, cores: int = 1) -> dict[str, str]:
    """Names and contents of the files of an OpenFOAM case; the hull is in the tank's folder."""
    values = _values(tank, case, grid, cores)
    names = [*_ALWAYS]
    names += ["0/k", "0/omega", "0/nut"] if case.turbulent else []
    names += ["0/pointDisplacement"] if not case.prescribed else []
    files = {name: str(_template(name.partition("/")[2]).render(values)) for name in names}
    if case.prescribed:
        files["constant/motion.dat"] = _motion_table(case, tank.step_of(case, grid))
    return files


@cache
def _template(name: str) -> Template:
    return templates("undertow.tank").get_template(name)  # dictionaries of OpenFOAM, filled with numbers only


def _values(tank: Tank, case: Case, grid: int, cores: int) -> dict[str, Any]:
    place = DOFS.index(case.motion)
    step, share = tank.step_of(case, grid), tank.share / case.copies
    k = 1.5 * (RULES.intensity * case.speed) ** 2
    inertia = case.inertia * share
    section = np.eye(3)[SECTION_AXES[case.motion]]
    return {
        **_block(tank, case, grid),
        "level": _halvings(tank, case),
        "bands": " ".join(f"({d:.6g} {n})" for d, n in _bands(tank)),
        "layers": case.layers,
        "end": f"{case.end:.12g}",
        "step": f"{step:.12g}",
        "interval": max(1, round(case.end / step / RULES.outputs)),
        "density": tank.density,
        "viscosity": tank.viscosity,
        "point": _vector(section * 0.25 * tank.cell_of(grid)),
        "normal": _vector(section),
        "corrections": 2 if case.prescribed else RULES.corrections,
        "cores": cores,
        "free": not case.prescribed,
        "turbulent": case.turbulent,
        "relaxation": f"{case.relaxation:.4g}",
        # A joint leaves one motion free: the other moments of inertia have no effect.
        "mass": f"{inertia if place < 3 else tank.mass * share:.9g}",
        "inertia": f"{inertia if place > 2 else inertia * tank.size**2 / 12:.9g}",
        "joint": f"{'PR'[place > 2]}{'xyz'[place % 3]}",
        "beyond": 1e3 * tank.size,  # nothing is deformed: all of the mesh moves with the hull
        **_push(case, place, share),
        "k": k,
        "omega": k / (RULES.eddies * tank.viscosity),
    }


def _push(case: Case, place: int, share: float) -> dict[str, str]:
    """The force on a free hull; a moment is a force at an arm of 1 m, whose push the joint takes up."""
    axis = place % 3
    direction = np.eye(3)[axis if place < 3 else (axis + 2) % 3]
    arm = np.eye(3)[(axis + 1) % 3] * (place > 2)
    rows = zip(case.times, case.signal, strict=True)
    table = "\n".join(f"    ({t:.9g} ({_vector(direction * s * case.peak * share)}))" for t, s in rows)
    return {"arm": _vector(arm), "force": f"\n{table}\n    "}


def _halvings(tank: Tank, case: Case) -> int:
    """From the cells far away to those at the hull: all others are twice as large where it has layers."""
    return tank.level + (case.layers is not None)


def _bands(tank: Tank) -> list[tuple[float, int]]:
    """Distances from the hull and the halvings of cells within them."""
    around = [(RULES.around * tank.size, 1)] if tank.level > 1 else []
    middle = [(2 * RULES.near * tank.size * (tank.level - n), n) for n in range(tank.level - 1, 1, -1)]
    return [(RULES.near * tank.size, tank.level), *middle, *around]


def _block(tank: Tank, case: Case, grid: int) -> dict[str, str]:
    """The block of water, cut at planes of symmetry, and what its faces are."""
    cut = [axis in case.planes for axis in _AXES]
    cell = tank.cell_of(grid) * 2 ** _halvings(tank, case)
    half = _whole(tank, case)
    low = [0.0 if c else -h for c, h in zip(cut, half, strict=True)]
    low[2] = low[2] if tank.depth is None else -tank.depth
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    points = [[(low[i], half[i])[c[i]] for i in range(3)] for c in corners]
    counts = [max(1, round((h - lo) / cell)) for h, lo in zip(half, low, strict=True)]
    far: list[str] = []
    # A patch for each direction: points where two planes meet would slide off both if they were one.
    flat: dict[str, str] = {}
    sides = [("0 4 7 3", "1 2 6 5"), ("0 1 5 4", "3 7 6 2"), ("0 3 2 1", "4 5 6 7")]
    for i, (lower, upper) in enumerate(sides):
        between = _AXES[i] == tank.span  # walls at both ends
        # No pressure at the surface while a push is over before gravity acts; a lid where no waves rise.
        lid = i == 2 and tank.depth is not None and case.profile != "push"
        if wall := [f"({lower})"] * (cut[i] or between or lid) + [f"({upper})"] * between:
            flat[_AXES[i]] = " ".join(wall)
        far += [f"({lower})"] * (not (cut[i] or between or lid)) + [f"({upper})"] * (not between)
    inside = [h - (0.37 + 0.04 * i) * min(cell, h) for i, h in enumerate(half)]
    return {
        "vertices": [_vector(p) for p in points],  # type: ignore[dict-item]
        "counts": " ".join(map(str, counts)),
        "far": " ".join(far),
        "cut": flat,  # type: ignore[dict-item]
        "inside": _vector(inside),
    }


def _whole(tank: Tank, case: Case) -> list[float]:
    """Half sides of the water, m: whole cells of the coarsest grid, so that all grids are alike."""
    far = tank.cell * 2 ** _halvings(tank, case)
    return [
        h if a == tank.span else far * float(np.ceil(h / far - 1e-6))
        for a, h in zip(_AXES, tank.half, strict=True)
    ]


def _motion_table(case: Case, step: float) -> str:
    """Places of a prescribed motion at the time steps, and beyond both ends for the spline through them."""
    at = np.arange(-3, round(case.end / step) + 4) * step
    times, speeds = np.array(case.times), case.peak * np.array(case.signal)
    places, _, _ = motion(times, speeds, np.clip(at, 0.0, case.end))
    beyond = np.maximum(at - case.end, 0.0) * speeds[-1]
    rows = [_pose(case.motion, x) for x in places + beyond]
    lines = "\n".join(f"({t:.10g} {row})" for t, row in zip(at, rows, strict=True))
    return f"(\n{lines}\n)\n"


def _pose(motion_name: str, x: float) -> str:
    pose = np.zeros(6)
    pose[DOFS.index(motion_name)] = x
    return f"(({_vector(pose[:3])}) ({_vector(np.degrees(pose[3:]))}))"


def _vector(values: Sequence[float] | Array) -> str:
    return " ".join(f"{0.0 + v:.10g}" for v in values)
