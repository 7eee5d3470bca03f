"""Running the cases of a tank with OpenFOAM: grids, solver, restarts, what diverged, and the logs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path
from signal import SIGFPE
from time import monotonic

import numpy as np

from undertow.errors import UndertowError
from undertow.files import read_json, write_whole
from undertow.model.symbols import DOFS
from undertow.typing import Array, Progress

from .case import case_files
from .coefficients import Record, write_record
from .settings import HULL, RULES, Case, Tank, folder_of, log_of, motion

_GRID = "grid.json"  # beside a grid: its cells, and the share of the hull that layers cover
INSTALL = "OpenFOAM is not installed (no {} on the PATH): apt-get install openfoam"
_TIME = re.compile(r"^Time = (\S+)")
_COURANT = re.compile(r"^Courant Number mean: \S+ max: (\S+)")
_RESIDUAL = re.compile(r"Solving for p, Initial residual = ([^,]+),")
_COVERED = re.compile(r"^hull\s+\d+\s+\S+\s+\S+\s+(\S+)\s*$", re.MULTILINE)  # % of the thickness asked for
_FATAL = re.compile(r"FOAM FATAL|Foam::sigFpe::sigHandler|^Floating point exception")


@dataclass
class SolverMonitor:
    """Reads what the solver prints while it runs."""

    end: float
    report: Callable[[float, str], None]
    time: float = 0.0
    courant: float = 0.0
    residual: float = 1.0  # of the pressure, at the start of the last correction
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=40))
    fatal: str = ""
    diverged: bool = False
    begun: float = field(default_factory=monotonic)
    first: float | None = None

    def line(self, line: str) -> None:
        """Take one line of its output."""
        self.tail.append(line)
        if found := _TIME.match(line):
            self.time = float(found[1])
            self.first = self.time if self.first is None else self.first
            now = f"t = {self.time:.3g} s, residual {self.residual:.1e}, Courant {self.courant:.2g}"
            self.report(self.time / self.end, now + self._left())
        elif found := _COURANT.match(line):
            self.courant = float(found[1])
            if not self.courant <= RULES.courant_limit:
                self.diverged = True
                self.fatal = f"Courant number {self.courant:.3g}, limit {RULES.courant_limit:g}"
        elif found := _RESIDUAL.search(line):
            self.residual = float(found[1])
        elif _FATAL.search(line):
            self.fatal = self.fatal or "the solver gave up"

    def _left(self) -> str:
        done = self.time - (self.first or 0.0)
        if done <= 0:
            return ""
        left = (monotonic() - self.begun) * max(self.end - self.time, 0.0) / done
        return f", {left / 60:.0f} min left" if left > 90 else f", {left:.0f} s left"


def need_openfoam(*programs: str) -> None:
    """Refuse where programs of OpenFOAM are not on the PATH."""
    for program in programs or ("blockMesh", "surfaceFeatureExtract", "snappyHexMesh", "pimpleFoam"):
        if shutil.which(program) is None:
            raise UndertowError(INSTALL.format(program))


def run_tank(
    root: Path, tank: Tank, *, grids: int = 1, cores: int = 1, progress: Progress | None = None
) -> list[str]:
    """Run all cases that have no log yet, on the coarsest grid first; a cut-off run goes on.

    Returns the names of the logs that were written. Raises `UndertowError` where OpenFOAM is missing, no grid
    can be made or a run diverges; logs written before stay.
    """
    if not 1 <= grids <= tank.grids:
        raise UndertowError(
            f"--grids {grids}: {root} has {tank.grids}: write more with undertow tank new --grids"
        )
    tell = progress or (lambda done, words: None)
    todo = [(g, c) for g, c in product(range(1, grids + 1), tank.cases) if not log_of(root, c, g).exists()]
    if todo:
        need_openfoam()
    if todo and cores > 1:
        need_openfoam("decomposePar", "mpirun")
    # A grid finer by r has r^3 times the cells and r times the steps.
    work = np.array([c.end / c.step * tank.refinement ** (4 * g) / c.copies for g, c in todo])
    ends = np.cumsum(work) / work.sum() if len(work) else work
    written = []
    for (grid, case), end, share in zip(todo, ends, work / max(work.sum(), 1e-9), strict=True):
        start = end - share
        label = f"{case.name}, grid {grid}: "

        def report(
            done: float, words: str, start: float = start, share: float = share, label: str = label
        ) -> None:
            tell(start + share * min(done, 1.0), label + words)

        _run_case(root, tank, case, grid, cores, report)
        written.append(log_of(root, case, grid).name)
    return written


def _run_case(root: Path, tank: Tank, case: Case, grid: int, cores: int, report: Progress) -> None:
    folder = folder_of(root, case, grid)
    if not (folder / "system" / "controlDict").is_file():
        raise UndertowError(f"{folder}: no OpenFOAM case there: write the tank again with undertow tank new")
    cells = _grid(root, case, folder, report)
    if not _reached(folder, case):  # it may have been cut off after the last step
        _distribute(tank, case, grid, folder, cores)
        solver = ["pimpleFoam"] if cores == 1 else ["mpirun", "-np", str(cores), "pimpleFoam", "-parallel"]
        watch = SolverMonitor(case.end, report)
        _execute(folder, solver, watch)
        if not _reached(folder, case):
            raise UndertowError(
                f"{folder}: the solver stopped at t = {watch.time:g} s: run the same command again to resume"
            )
    record = read_results(tank, case, grid, folder, cells)
    write_record(log_of(root, case, grid), record, tank, case)


def _reached(folder: Path, case: Case) -> bool:
    """Whether the forces are there up to the end."""
    times = _forces(folder, DOFS.index(case.motion))
    return bool(times) and max(times) >= case.end * (1 - RULES.reached)


# --- programs -------------------------------------------------------------------------------------
def _execute(folder: Path, command: list[str], watch: SolverMonitor) -> None:
    """Run a program of OpenFOAM to its end, its output into a log in the folder, or stop what diverges."""
    name = next(part for part in command if part not in ("mpirun", "-np") and not part.isdigit())
    environment = {
        "WM_PROJECT_DIR": "/usr/share/openfoam",
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        **os.environ,
    }
    with (
        (folder / f"log.{name}").open("a", encoding="utf-8") as log,
        subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        ) as process,
    ):
        ended = False
        try:
            for line in process.stdout or ():
                log.write(line)
                watch.line(line)
                if watch.diverged:
                    break
            ended = not watch.diverged
        finally:
            # Ctrl-C ends here, too: what has been written until then is where the next run begins.
            if not ended:
                process.terminate()
    if watch.fatal or process.returncode:
        raise UndertowError(_reason(folder, name, watch, process.returncode))


def _reason(folder: Path, name: str, watch: SolverMonitor, code: int) -> str:
    """Why a program failed, in one line."""
    if name != "pimpleFoam":
        shown = _fatal(watch) or f"exit code {code}"
        return f"{folder}: {name} failed: {shown}: see {folder / f'log.{name}'}"
    if said := _fatal(watch):
        return f"{folder}: {name} stopped: {said}: see {folder / f'log.{name}'}"
    if not watch.fatal and code < 0 and code != -SIGFPE:
        return (
            f"{folder}: the solver was killed at t = {watch.time:.4g} s (signal {-code}; 9 may mean out of "
            "memory): run the same command again to resume"
        )
    what = watch.fatal or f"exit code {code}"
    return (
        f"{folder}: diverged at t = {watch.time:.4g} s ({what}): write the tank again with a smaller "
        "--time-step, a lower --speed or a larger --mass"
    )


def _fatal(watch: SolverMonitor) -> str:
    """What a program of OpenFOAM said when it gave up, or nothing."""
    words = [line.strip() for line in watch.tail if line.strip()]
    fatal = [i for i, line in enumerate(words) if "FATAL" in line]
    return " ".join(words[fatal[0] + 1 :][:3])[:200] if fatal else ""


def _grid(root: Path, case: Case, folder: Path, report: Progress) -> int:
    """Make the grid if it is not there, and count its cells."""
    mark = folder / _GRID
    if "cells" in (said := _grid_note(mark)):
        return int(said["cells"])
    shutil.rmtree(folder / "constant" / "polyMesh", ignore_errors=True)
    surface = folder / "constant" / "triSurface"
    surface.mkdir(exist_ok=True)
    (surface / HULL).unlink(missing_ok=True)
    (surface / HULL).symlink_to(os.path.relpath(root / HULL, surface))
    cells, covered = 0, 1.0
    for program in ("blockMesh", "surfaceFeatureExtract", "snappyHexMesh"):
        (folder / f"log.{program}").unlink(missing_ok=True)
        report(0.0, f"{program} makes the grid")
        command = [program, *(["-overwrite"] if program == "snappyHexMesh" else [])]
        watch = SolverMonitor(1.0, lambda done, words: None)
        _execute(folder, command, watch)
        text = (folder / f"log.{program}").read_text(encoding="utf-8")
        cells = int((re.findall(r"cells:\s*(\d+)", text) or [cells])[-1])
        if case.layers is not None and (shares := _COVERED.findall(text)):
            covered = float(shares[-1]) / 100
    write_whole(mark, f'{{"cells": {cells}, "covered": {covered}}}\n')
    return cells


def _grid_note(mark: Path) -> dict[str, float]:
    """What is noted of a grid; nothing where it has not been made."""
    text = read_json(mark, "grid") if mark.is_file() else ""
    return {name: float(value) for name, value in re.findall(r'"(\w+)": (\d[.\d]*)', text)}


def unlayered(root: Path, tank: Tank) -> Iterator[str]:
    """A line for each grid that has layers on part of the hull only."""
    for case, grid in product(tank.cases, range(1, tank.grids + 1)):
        covered = _grid_note(folder_of(root, case, grid) / _GRID).get("covered", 1.0)
        if covered < RULES.covered:
            yield (
                f"{case.name}, grid {grid}: layers cover {covered:.0%} of the hull, less than "
                f"{RULES.covered:.0%}: do not rely on its drag, or leave small parts out of the mesh "
                "of the hull and round off inner corners"
            )


def _distribute(tank: Tank, case: Case, grid: int, folder: Path, cores: int) -> None:
    """Share the grid between cores; a run that was begun on another number of them starts anew."""
    parts = list(folder.glob("processor*"))
    if len(parts) == (cores if cores > 1 else 0):
        return
    for part in parts:
        shutil.rmtree(part)
    if cores > 1:
        text = case_files(tank, case, grid, cores)["system/decomposeParDict"]
        write_whole(folder / "system" / "decomposeParDict", text)
        _execute(folder, ["decomposePar", "-force"], SolverMonitor(1.0, lambda done, words: None))


# --- results --------------------------------------------------------------------------------------
def read_forces(folder: Path, place: int) -> tuple[Array, Array]:
    """Times (n,), s, and force or moment of the water (n,), N or N m, for one of the six motions.

    A run that was taken up again has written several files; the later ones count.
    """
    rows = _forces(folder, place)
    if not rows:
        raise UndertowError(f"{folder}: the solver wrote no forces: run it again")
    times = sorted(rows)
    return np.array(times), np.array([rows[t] for t in times])


def _forces(folder: Path, place: int) -> dict[float, float]:
    name = "force.dat" if place < 3 else "moment.dat"
    rows: dict[float, float] = {}
    files = sorted(folder.glob(f"postProcessing/forces/*/{name}"), key=lambda p: float(p.parent.name))
    for path in files:
        begun = float(path.parent.name)
        rows = {t: f for t, f in rows.items() if t <= begun + RULES.same_time}
        rows.update(_force_rows(path, place % 3))
    return rows


def _force_rows(path: Path, axis: int) -> Iterator[tuple[float, float]]:
    for line in path.read_text(encoding="utf-8").splitlines():
        numbers = line.replace("(", " ").replace(")", " ").split()
        if line[:1] != "#" and len(numbers) > 3:
            yield float(numbers[0]), float(numbers[1 + axis])


def read_motion(folder: Path, place: int) -> Array:
    """Time, place and speed of a free hull at every time step, shape (3, n); a later run's rows count."""
    rows: dict[float, tuple[float, float]] = {}
    now, found = 0.0, dict[str, list[float]]()
    for line in (folder / "log.pimpleFoam").read_text(encoding="utf-8", errors="replace").splitlines():
        if match := _TIME.match(line):
            now = float(match[1])
            rows = {t: row for t, row in rows.items() if t < now - RULES.same_time}
        elif match := re.match(
            r"\s+(Centre of rotation|Orientation|Linear velocity|Angular velocity): \((.*)\)", line
        ):
            found[match[1]] = [float(word) for word in match[2].split()]
            if match[1] == "Angular velocity":
                rows[now] = _state(found, place)
    if not rows:
        raise UndertowError(f"{folder}: the solver printed no motion: run it again")
    return np.array([(t, *row) for t, row in rows.items()]).T


def _state(found: dict[str, list[float]], place: int) -> tuple[float, float]:
    axis = place % 3
    if place < 3:
        return found["Centre of rotation"][axis], found["Linear velocity"][axis]
    matrix = np.array(found["Orientation"]).reshape(3, 3)  # from the axes of the water to those of the hull
    one, two = (axis + 1) % 3, (axis + 2) % 3
    return float(np.arctan2(matrix[one, two], matrix[one, one])), found["Angular velocity"][axis]


def processor_seconds(folder: Path) -> float:
    """What the solver has taken, also where it was taken up again, s."""
    path = folder / "log.pimpleFoam"
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    taken = [float(word) for word in re.findall(r"^ExecutionTime = (\S+) s", text, re.MULTILINE)]
    return sum(now for now, later in pairwise([*taken, 0.0]) if later < now)


def read_results(tank: Tank, case: Case, grid: int, folder: Path, cells: int) -> Record:
    """What a case has given: motion, acceleration, force of the water, force on the hull from outside."""
    place = DOFS.index(case.motion)
    times, water = read_forces(folder, place)
    water = water * case.copies / tank.share
    signal_times, signal = np.array(case.times), case.peak * np.array(case.signal)
    if case.prescribed:
        x, v, a = motion(signal_times, signal, np.minimum(times, case.end))
        push = case.inertia * a - water
    else:
        t, x, v = read_motion(folder, place)
        x = np.unwrap(x) if place > 2 else x
        x, v = np.interp(times, t, x), np.interp(times, t, v)
        push = np.interp(times, signal_times, signal)
        a = (push + water) / case.inertia
    if not all(np.isfinite(row).all() for row in (x, v, a, water)):
        raise UndertowError(
            f"{folder}: diverged (a force is not a number): write the tank again with a smaller --time-step"
        )
    if not case.prescribed and (off := _speed_mismatch(times, v, a)) > RULES.apart:
        raise UndertowError(
            f"{folder}: the speed of the hull gets {off:.0%} away from that of its forces, limit "
            f"{RULES.apart:.0%}: write the tank again with a smaller --time-step or --prescribed"
        )
    return Record(times, push, x, v, a, water, grid, cells, processor_seconds(folder))


def _speed_mismatch(times: Array, speed: Array, acceleration: Array) -> float:
    """How far the speed gets from that by the forces, in highest speeds."""
    mean = (acceleration[1:] + acceleration[:-1]) / 2
    off = speed[1:] - speed[0] - np.cumsum(mean * np.diff(times))
    return float(np.abs(off).max() / max(np.abs(speed).max(), 1e-300))
