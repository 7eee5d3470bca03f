"""The paper's chain and the estimators of undertow on logs of the tank, against what forced motion says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import undertow as ut
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.symbols import DOFS, FORCE, VELOCITY
from undertow.model.vehicle import Value, Vehicle
from undertow.paper.least_squares import identify
from undertow.tank.coefficients import Coefficient, coefficients, tank_vehicle
from undertow.tank.settings import Case, Tank, log_of, read_tank

SPACING = 0.2  # s, between samples, as in the paper
START, WIDE = 0.5, 3.0  # fits begin at half the truth, and hardly hold on to it: sigma over the truth
METHODS = {"weak": "weak form", "default": "weak form, then output error"}
AT = {
    "surge": 0.15,
    "heave": 0.15,
    "yaw": 0.5,
}  # m/s, rad/s: half the highest speed, at which drag is compared


def compare(forced: Path, free: Path) -> list[dict[str, Any]]:
    """A row for each motion, way and estimator; `forced`, `free`: tanks with the logs that are there."""
    truth, pushed = read_tank(forced), read_tank(free)
    cases = [c for c in pushed.cases if log_of(free, c, 1).is_file()]
    return list(chain.from_iterable(_of_case(forced, truth, free, case) for case in cases))


def known(root: Path, tank: Tank, motion: str, direction: int) -> list[Coefficient]:
    """What forced motion says of a motion in one direction; empty where logs are missing."""
    own = tuple(
        c for c in tank.cases if c.motion == motion and (c.direction == direction or "ward" not in c.name)
    )
    if not own or not all(log_of(root, c, 1).is_file() for c in own):
        return []
    # A single direction is taken for both, and its signs are those of the way ahead.
    one = tank.model_copy(update={"cases": own, "grids": 1})
    if direction < 0 and any("ward" in c.name for c in own):
        return [c for c in coefficients(root, one) if c.direction < 0]
    return coefficients(root, one)


def _of_case(forced: Path, tank: Tank, free: Path, case: Case) -> Iterator[dict[str, Any]]:
    found = known(forced, tank, case.motion, case.direction)
    if not found:
        return
    place = DOFS.index(case.motion)
    force, speed = FORCE[place], VELOCITY[place]
    names = (f"{force}_{speed}dot", f"{force}_{speed}", f"{force}_{speed}abs{speed}")
    truth = {c.name: c.value for c in found}
    with TemporaryDirectory() as folder:
        vehicle = _vehicle(tank, found, names, Path(folder))
        run = _thinned(free, case, Path(folder))
    head = {"motion": case.motion, "direction": case.direction, "inertia": case.inertia}
    yield head | {"by": "forced motion", "values": [truth[n] for n in names], "physical": True}
    done = identify(vehicle, [run], "all")
    for estimation in done.found[0][1]:
        values = {n: -v for n, v in estimation.values.items()}
        inertia = estimation.inertia[0] - case.inertia
        row = [inertia, values.get(names[1]), values.get(names[2])]
        yield head | {"by": f"case {estimation.case.name}", "values": row, "physical": estimation.valid}
    for method, words in METHODS.items():
        fitted = ut.fit(vehicle, [run], method=method).vehicle
        yield head | {"by": words, "values": [-fitted.value_of(n).value for n in names], "physical": True}


def _vehicle(tank: Tank, found: list[Coefficient], names: tuple[str, ...], folder: Path) -> Vehicle:
    """A model to be fitted, which begins off the truth."""
    file = folder / "auv.toml"
    file.write_text(tank_vehicle(tank, found, "auv"), encoding="utf-8")
    vehicle = load_vehicle(file)
    begin = {c.name: Value(-START * c.value, True, WIDE * max(c.value, 1e-3)) for c in found}
    return vehicle.with_values({n: begin[n] for n in names})


def _thinned(root: Path, case: Case, folder: Path) -> Run:
    """A log of the tank with samples at most as far apart as those of the paper."""
    log = log_of(root, case, 1)
    head, *rows = log.read_text(encoding="utf-8").splitlines()
    step = float(rows[1].split(",")[0]) - float(rows[0].split(",")[0])
    every = max(1, int(SPACING / step))
    thin = folder / log.name
    thin.write_text("\n".join([head, *rows[every - 1 :: every]]) + "\n", encoding="utf-8")
    return ut.read_log(thin, log.with_suffix(".toml"))


# --- the table ------------------------------------------------------------------------------------
_WAYS = {1: "ahead", -1: "back"}


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each motion and way: how far the paper's cases and the weak form are from forced motion."""
    yield "| motion | physical cases | inertia off by, all cases | drag off by | weak form: inertia | drag |"
    yield "|---|---|---|---|---|---|"
    for key in dict.fromkeys(map(_key, rows)):
        own = [r for r in rows if _key(r) == key]
        truth = next(r for r in own if r["by"] == "forced motion")
        cases = [r for r in own if r["by"].startswith("case ")]
        physical = [r["by"].removeprefix("case ") for r in cases if r["physical"]]
        (weak,) = (_off(r, truth) for r in own if r["by"] == METHODS["weak"])
        inertia, drag = zip(*(_off(r, truth) for r in cases), strict=True)
        shown = "none" if not physical else "all" if len(physical) == len(cases) else ", ".join(physical)
        yield (
            f"| {key[0]} {_WAYS[key[1]]} | {shown} | {_range(inertia, 1)} | "
            f"{_range(drag, 0)} | {weak[0]:+.1f}% | {weak[1]:+.0f}% |"
        )


def _off(row: dict[str, Any], truth: dict[str, Any]) -> tuple[float, float]:
    """How far inertia, and drag at half the highest speed, are from those of forced motion, %."""
    a, d, q = (np.nan if v is None else v for v in row["values"])
    a0, d0, q0 = truth["values"]
    speed = AT[row["motion"]]
    drag = (d * speed + q * speed**2) / (d0 * speed + q0 * speed**2) - 1
    return 100 * (a - a0) / (truth["inertia"] + a0), 100 * drag


def _range(values: Sequence[float], digits: int) -> str:
    return f"{min(values):+.{digits}f} to {max(values):+.{digits}f}%"


def _key(row: dict[str, Any]) -> tuple[str, int]:
    return row["motion"], row["direction"]
