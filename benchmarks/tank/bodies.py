"""Bodies in the tank: what is run, and what is known of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.shape.hulls import box_mesh, cylinder_mesh, revolved
from undertow.files import make_folder, together, write_whole
from undertow.model.symbols import DOFS
from undertow.shape.bodies import box, prolate_spheroid, sphere
from undertow.shape.mesh import Mesh, repaired, stl_bytes
from undertow.tank.case import TankPlan, make_tank, write_tank
from undertow.tank.coefficients import Coefficient, Record, coefficients, convergence, read_record
from undertow.tank.pictures import picture
from undertow.tank.run import run_tank
from undertow.tank.settings import FILE, Tank, log_of, read_tank
from undertow.typing import Progress

from .auv import MASS, auv_hull

BOX = (0.60, 0.42, 0.24)
RADIUS = 0.25
SHELF = Path(__file__).parent / "logs"
BALL = str(Path(__file__).with_name("sphere.csv"))
CYLINDER = str(Path(__file__).with_name("cylinder.csv"))
BULLET = str(Path(__file__).with_name("bullet.csv"))
AUV_STL = SHELF / "auv.stl"
SHIPPED = Path("src/undertow/demo_data/cfd-surge/surge_step_coarse.csv.gz")


def _spheroid(a: float, b: float) -> Mesh:
    angles = np.linspace(0.0, np.pi, 41)
    return revolved([(float(-a * np.cos(t)), float(b * np.sin(t))) for t in angles], 80)


def _bullet() -> Mesh:
    """A half-sphere and a cylinder as long as its radius with a flat base: forward and backward differ."""
    angles = np.linspace(np.pi / 2, np.pi, 21)
    nose = [(float(-RADIUS * np.cos(t)), float(RADIUS * np.sin(t))) for t in angles]
    return revolved([(-RADIUS, 0.0), *((x, RADIUS) for x in np.linspace(-RADIUS, 0.0, 6)[:-1]), *nose], 80)


def _cylinder() -> Mesh:
    """A circular cylinder across the flow, 0.5 m thick; walls cut it, so that it has no ends."""
    along_x = cylinder_mesh(2.0, 2 * RADIUS, 96)
    return Mesh(along_x.vertices[:, [1, 0, 2]], along_x.faces[:, ::-1])


@dataclass(frozen=True)
class Body:
    """A hull, what is done with it, and its exact added mass by name."""

    title: str
    hull: Callable[[], Mesh]
    orders: TankPlan
    grids: int
    truth: dict[str, float]
    source: str
    longer: dict[str, float] = field(default_factory=dict)  # factor on the time step of a case
    coarser: bool = False  # whether the first grid is one step coarser than by the rules, to save time
    bare: bool = False  # whether layers are left out


def _lamb(matrix: Any) -> dict[str, float]:
    return dict(
        zip(("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot"), np.diag(matrix), strict=True)
    )


def _push(mass: float, motions: tuple[str, ...] = ("surge",), prescribed: bool = True) -> TankPlan:
    return TankPlan(mass, motions=motions, profiles=("push",), prescribed=prescribed)


_SPHERE = _lamb(sphere(RADIUS).matrix)
_BOX = _lamb(box(*BOX).matrix)
_PANELS = {"X_udot": 0.6404, "Z_wdot": 9.69, "N_rdot": 0.06621}  # of the AUV: docs/story.md
_STEP = TankPlan(60.48, profiles=("step",), prescribed=True, step=4.0)
_VISCOUS = TankPlan(
    65.4, profiles=("step",), prescribed=True, viscosity=0.0015
)  # Reynolds 50 and 100 at 0.3 m/s


BODIES = {
    "sphere": Body(
        "sphere, diameter 0.5 m", lambda: _spheroid(RADIUS, RADIUS), _push(65.3), 3, _SPHERE, "Lamb"
    ),
    "sphere-shallow": Body(
        "the same sphere, its centre one diameter below the surface",
        lambda: _spheroid(RADIUS, RADIUS),
        TankPlan(65.3, motions=("surge", "heave"), profiles=("push",), prescribed=True, depth=2 * RADIUS),
        3,
        {
            "X_udot": 32.0,
            "Z_wdot": 31.3,
        },  # undertow added-mass mesh --depth 0.5 --panels 800, which says +- 0.6
        "panels",
    ),
    "spheroid": Body(
        "spheroid 0.6 x 0.2 m",
        lambda: _spheroid(0.3, 0.1),
        _push(12.5, ("surge", "sway", "yaw")),
        3,
        _lamb(prolate_spheroid(0.6, 0.2).matrix),
        "Lamb",
    ),
    "box": Body("box 0.60 x 0.42 x 0.24 m", lambda: box_mesh(BOX), _push(60.48), 3, _BOX, "panels"),
    "box-across": Body(
        "the same box", lambda: box_mesh(BOX), _push(60.48, ("sway", "heave")), 3, _BOX, "panels"
    ),
    "box-turning": Body("the same box", lambda: box_mesh(BOX), _push(60.48, ("yaw",)), 3, _BOX, "panels"),
    "box-free": Body(
        "the same box, pushed by a force",
        lambda: box_mesh(BOX),
        _push(60.48, prescribed=False),
        3,
        _BOX,
        "panels",
    ),
    "box-light": Body(
        "a box like it of 7.5 kg, pushed by a force",
        lambda: box_mesh(BOX),
        _push(7.5, ("heave",), prescribed=False),
        3,
        _BOX,
        "panels",
    ),
    "box-forced": Body(
        "the same box, steps of 5 N for 10 s",
        lambda: box_mesh(BOX),
        TankPlan(60.48, profiles=("step",), force=5.0),
        3,
        _BOX,
        "panels",
    ),
    "box-bare": Body(
        "the same, without layers",  # as the run that is shipped
        lambda: box_mesh(BOX),
        TankPlan(60.48, profiles=("step",), force=5.0),
        1,
        _BOX,
        "panels",
        bare=True,
    ),
    "re100": Body(
        "sphere, Reynolds 50 and 100", lambda: _spheroid(RADIUS, RADIUS), _VISCOUS, 3, {}, "", coarser=True
    ),
    "re200": Body(
        "sphere, Reynolds 150 and 200",
        lambda: _spheroid(RADIUS, RADIUS),
        TankPlan(65.4, profiles=(BALL,), prescribed=True, viscosity=0.00075, step=4.0, grids=4),
        3,
        {},
        "",
        coarser=True,
    ),
    "cylinder": Body(
        "cylinder across, without ends",
        _cylinder,
        TankPlan(393.0, profiles=("push",), prescribed=True, span="y"),
        3,
        {"X_udot": 1000.0 * np.pi * RADIUS**2 * 2.0},
        "Lamb",
    ),
    "cylinder-drag": Body(
        "the same cylinder, Reynolds 20 and 40",
        _cylinder,
        TankPlan(393.0, profiles=(CYLINDER,), prescribed=True, viscosity=0.00375, span="y", step=4.0),
        3,
        {},
        "",
        coarser=True,
    ),
    "box-steps": Body("the same box, steps of speed", lambda: box_mesh(BOX), _STEP, 3, {}, ""),
    "bullet": Body(
        "half-sphere before a cylinder, 0.5 x 0.5 m",
        _bullet,
        TankPlan(80.0, profiles=("push", "step"), prescribed=True),
        3,
        {
            "X_udot": 44.6
        },  # 1504 panels (undertow added-mass mesh --panels 1600), which say +- 0.7 of themselves
        "panels",
        longer={"surge-step-forward": 4.0, "surge-step-backward": 4.0},
    ),
    "bullet-back": Body(
        "the same, flat end first for 20 diameters",
        _bullet,
        TankPlan(80.0, profiles=(BULLET,), prescribed=True, step=4.0),
        3,
        {},
        "",
    ),
    "auv": Body(
        "small AUV, 0.60 m, 7.5 kg",
        auv_hull,
        TankPlan(MASS, profiles=("push", "step"), prescribed=True, grids=4),
        4,
        _PANELS,
        "panels",
        longer={"surge-step-forward": 8.0, "surge-step-backward": 8.0},
        coarser=True,
    ),
    "auv-across": Body(
        "the same AUV",
        auv_hull,
        TankPlan(MASS, motions=("heave", "yaw"), profiles=("push", "step"), prescribed=True, grids=4),
        3,
        _PANELS,
        "panels",
        longer={"yaw-step": 4.0},
        coarser=True,
    ),
    "auv-paper": Body(
        "the same AUV, pushed by the forces of the paper",
        auv_hull,
        TankPlan(MASS, motions=("surge", "heave", "yaw"), profiles=("paper",), step=4.0),
        1,
        {},
        "",
        # Force and acceleration of a hull that sets much water in motion agree in small time steps only.
        longer={"heave-paper-forward": 0.25, "heave-paper-backward": 0.25, "yaw-paper": 0.5},
        coarser=True,
    ),
}


def made(name: str, work: Path) -> Tank:
    """The tank of a body, written into a folder if it is not there."""
    body, root = BODIES[name], work / name
    if not (root / FILE).exists():
        surface = repaired(body.hull(), name)[0]
        written = sha256(stl_bytes(surface)).hexdigest()
        tank, hull = make_tank(surface, body.orders, f"{name}.stl", written)
        ratio = tank.refinement if body.coarser else 1.0
        kept = tuple(
            c.model_copy(
                update={
                    "step": c.step * ratio * body.longer.get(c.name, 1.0),
                    "layers": None if body.bare else c.layers,
                }
            )
            for c in tank.cases
        )
        write_tank(root, tank.model_copy(update={"cases": kept, "cell": tank.cell * ratio}), hull)
    return read_tank(root)


def run(name: str, work: Path, progress: Progress) -> list[dict[str, Any]]:
    """Run what is missing of a body in a folder, and return what came out."""
    body, root = BODIES[name], work / name
    tank = made(name, work)
    run_tank(root, tank, grids=body.grids, progress=progress)
    return results(name, root)


def results(name: str, root: Path) -> list[dict[str, Any]]:
    """What the logs of a body in a folder say."""
    tank = read_tank(root)
    if name == "bullet-back":
        return [_wake(name, root, tank)]
    found = [*_coefficients(name, root, tank), *_drag(name, root, tank)]
    return [*found, _against_demo(name, root, tank)] if name in ("box-forced", "box-bare") else found


def _wake(name: str, root: Path, tank: Tank) -> dict[str, Any]:
    """Drag coefficient over the last ten diameters at one speed, on each grid, coarsest first."""
    case, area = tank.cases[0], BODIES[name].hull().projected_area(0)
    logs = [log_of(root, case, g) for g in range(1, BODIES[name].grids + 1)]
    done = [(log, read_record(log, g)) for g, log in enumerate(logs, start=1) if log.is_file()]
    late = [_late_drag(record, tank.density / 2 * area) for _, record in done]
    return {
        "body": name,
        "name": "wake",
        "direction": 0,
        **{key: [found[key] for found in late] for key in ("mean", "rms", "trend")},
        "cells": [record.cells for _, record in done],
        "seconds": [_seconds(log) for log, _ in done],
    }


def _late_drag(record: Record, pressed: float) -> dict[str, float]:
    """Mean, root mean square and fall in a diameter of a drag coefficient; `pressed`: for 1 m/s, N."""
    way = np.abs(record.place - record.place[-1]) / (2 * RADIUS)
    late = way <= 10
    drag = np.abs(record.water[late]) / (pressed * record.speed[late] ** 2)
    return {
        "mean": float(drag.mean()),
        "rms": float(drag.std()),
        "trend": float(-np.polyfit(way[late], drag, 1)[0]),
    }


def _against_demo(name: str, root: Path, tank: Tank) -> dict[str, Any]:
    """How far the speed is from that of the shipped run, which other scripts made: root mean squares, m/s,
    on each grid, coarsest first."""
    shipped = np.genfromtxt(SHIPPED, delimiter=",", names=True)
    logs = {g: log_of(root, tank.cases[0], g) for g in range(1, tank.grids + 1)}
    records = [read_record(log, g) for g, log in logs.items() if log.is_file()]
    off = [np.interp(shipped["t_s"], r.time, r.speed) - shipped["velocity_m_s"] for r in records]
    speed = float(np.sqrt(np.mean(shipped["velocity_m_s"] ** 2)))
    rms = [float(np.sqrt(np.mean(each**2))) for each in off]
    return {"body": name, "name": "rms", "direction": 0, "off": rms, "speed": speed}


def shelf(name: str) -> Path:
    """Where the logs of a body are kept; those of the AUV are part of the demo."""
    return Path("src/undertow/demo_data/tank") if name == "auv" else SHELF / name


def ship(name: str, work: Path) -> None:
    """Put what is small of a tank that was run beside the benchmark: hull, tank.toml, logs."""
    target, root = shelf(name), work / name
    tank = made(name, work)
    pairs = product(tank.cases, range(1, tank.grids + 1))
    done = {(c.name, g): log for c, g in pairs if (log := log_of(root, c, g)).is_file()}
    names, grids = zip(*done, strict=True)
    cases = tuple(c for c in tank.cases if c.name in names)
    kept = tank.model_copy(update={"cases": cases, "grids": max(grids)})
    with together():
        make_folder(target / "logs")
        if name == "auv":  # the other tanks of the benchmark have the same hull
            write_whole(AUV_STL, stl_bytes(repaired(BODIES[name].hull(), name)[0]))
        write_whole(target / FILE, kept.text())
        for log in done.values():
            for path in (log, log.with_suffix(".toml")):
                write_whole(target / "logs" / path.name, path.read_text(encoding="utf-8"))


def drawing(name: str, work: Path, case_name: str) -> Figure:
    """The picture of a case of a body on its finest grid."""
    root = work / name
    tank = read_tank(root)
    case = next(c for c in tank.cases if c.name == case_name)
    grid = max(g for g in range(1, tank.grids + 1) if log_of(root, case, g).is_file())
    return picture(root, tank, case, grid, coefficients(root, tank))


def _coefficients(name: str, root: Path, tank: Tank) -> list[dict[str, Any]]:
    body = BODIES[name]
    return [
        {
            "body": name,
            "name": c.name,
            "direction": c.direction,
            "value": c.value,
            "sigma": c.sigma,
            "grid": asdict(c.grid),
            "truth": body.truth.get(c.name),  # alike in both directions
            "source": body.source,
            **_effort(root, tank, c, body.grids),
        }
        for c in coefficients(root, tank)
        if name not in ("re100", "re200", "cylinder-drag")  # drag that is neither linear nor quadratic
    ]


def _effort(root: Path, tank: Tank, of: Coefficient, grids: int) -> dict[str, Any]:
    """Cells and processor seconds of the grids, coarsest first: of the pushes that an added mass is from, or
    of the other cases."""
    cases = [c for c in tank.cases if c.motion == of.motion and c.direction * of.direction >= 0]
    pushed = of.effect == "added_mass" and any(c.profile == "push" for c in cases)
    logs = {
        g: [log_of(root, c, g) for c in cases if (c.profile == "push") == pushed] for g in range(1, grids + 1)
    }
    done = {g: own for g, each in logs.items() if (own := [log for log in each if log.is_file()])}
    return {
        "cells": [read_record(own[0], g).cells for g, own in done.items()],
        "seconds": [sum(map(_seconds, own)) for own in done.values()],
    }


def _seconds(log: Path) -> int:
    text = log.with_suffix(".toml").read_text(encoding="utf-8")
    return int(re.findall(r"(\d+) s of a processor", text)[0])


def _drag(name: str, root: Path, tank: Tank) -> list[dict[str, Any]]:
    """Drag coefficients on the silhouette at the end of each speed of the steps, on all grids."""
    body, rows = BODIES[name], []
    hull = repaired(body.hull(), name)[0]
    steps = [
        c for c in tank.cases if c.profile in ("step", "table") and c.prescribed and c.motion in DOFS[:3]
    ]
    for case in steps:
        place = DOFS.index(case.motion)
        grids = [g for g in range(body.grids, 0, -1) if log_of(root, case, g).is_file()]
        records = [read_record(log_of(root, case, g), g) for g in grids]
        for end in (2 / 3 * case.end, case.end) if grids else ():
            now = [np.searchsorted(r.time, end * (1 - 1e-6), side="right") - 1 for r in records]
            u = float(records[0].speed[now[0]])
            pressed = tank.density / 2 * hull.projected_area(place) * u**2
            values = [float(-r.water[i] * np.sign(u) / pressed) for r, i in zip(records, now, strict=True)]
            rows.append(
                {
                    "body": name,
                    "name": "Cd",
                    "motion": case.motion,
                    "direction": case.direction * ("ward" in case.name),
                    "speed": u,
                    "reynolds": float(abs(u) * tank.size / tank.viscosity),
                    "value": values[0],
                    "grid": asdict(convergence(values, [tank.cell_of(g) for g in grids], drag=True)),
                    "cells": [r.cells for r in reversed(records)],
                    "seconds": [_seconds(log_of(root, case, g)) for g in reversed(grids)],
                }
            )
    return rows
