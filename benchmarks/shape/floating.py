"""Hulls at the surface, and docs/floating.md: python -m benchmarks.shape.floating --help"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from undertow.errors import UndertowError
from undertow.figures import COLOURS, FAINT, figure, look, save_png
from undertow.files import write_whole
from undertow.shape.bodies import AddedMass
from undertow.shape.floating import FloatingBody, FloatingHull
from undertow.shape.floating_vehicle import fit_memory, heading_error
from undertow.typing import Progress

from ..progress import clear, progress_line
from .hulls import ball
from .hulme import ADDED, DAMPING
from .usv import CG, MASS, usv_hull
from .wamit import VOLUME, WAMIT, cylinder_hull

RESULTS = Path(__file__).parent / "floating.json"
TEXT = Path(__file__).parent / "floating.md"
RHO, G = 1000.0, 9.81
HALF = 2 / 3 * np.pi * RHO  # kg, displaced by a half-sphere of radius 1 m
WAVES = (2.5, 4.0, 6.0)  # rad/s
MOTIONS = ("surge", "sway", "heave", "roll", "pitch", "yaw")


def measure(finest: int, progress: Progress) -> dict[str, Any]:
    """Everything on the page that takes panels."""
    progress(0.0, "half-sphere")
    round_ = FloatingBody(ball(4), HALF, 0.3, RHO, finest)
    rows = []
    for motion, i in (("surge", 0), ("heave", 2)):
        for ka in ADDED[motion]:
            found = round_.at(float(np.sqrt(G * ka)))[i, i] / HALF
            rows.append({"motion": motion, "ka": ka, "A": found.real, "B": found.imag / np.sqrt(G * ka)})
    progress(0.3, "cylinder")
    cylinder, cylinder_panels = against_wamit(finest)
    progress(0.4, "a small surface vehicle")
    body = FloatingBody(usv_hull(), MASS, CG, RHO, finest)
    inertia = np.diag([MASS] * 3 + [3.1, 26.0, 27.0])
    hull = body.radiation()
    progress(0.8, "waves")
    waves = [body.regular_wave(w, inertia) for w in WAVES]
    return {
        "sphere": rows,
        "sphere_panels": round_.panels,
        "cylinder": cylinder,
        "cylinder_panels": cylinder_panels,
        "usv": {
            "draught": hull.draught, "length": hull.length, "panels": hull.panels,
            "omega": hull.omega.tolist(), "infinity": hull.at_infinity.matrix.tolist(),
            "A": hull.added.tolist(), "B": hull.damping.tolist(),
        },
        "waves": [
            {
                "omega": w.omega, "headings": w.headings.tolist(),
                "force": np.abs(w.excitation).tolist(), "motion": np.abs(w.motion).tolist(),
                "drift": w.drift.tolist(), "missed": heading_error(w),
            }
            for w in waves
        ],
    }  # fmt: skip


def against_wamit(finest: int) -> tuple[list[dict[str, Any]], int]:
    """Added mass, damping and excitation of a cylinder, in the units of WAMIT, and the panels under water."""
    body = FloatingBody(cylinder_hull(), VOLUME * RHO, 0.4, RHO, finest)
    rows = []
    for omega, known in WAMIT.items():
        matrix = body.at(omega)
        wave = body.regular_wave(omega, np.diag([VOLUME * RHO] * 3 + [20.0] * 3))
        for i, (motion, table) in enumerate(zip(("surge", "heave", "pitch"), known, strict=True)):
            own = matrix[2 * i, 2 * i]
            values = (own.real / RHO, own.imag / RHO / omega, abs(wave.excitation[0, 2 * i]) / RHO / G)
            rows.append({"motion": motion, "omega": omega, "values": values, "wamit": table})
    return rows, body.panels


def afloat(stored: dict[str, Any]) -> FloatingHull:
    """The surface vehicle out of stored results."""
    infinity = AddedMass(np.array(stored["infinity"]), "", "", np.zeros((6, 6)))
    omega, added, damping = (np.array(stored[n]) for n in ("omega", "A", "B"))
    return FloatingHull(
        np.zeros(3), stored["draught"], stored["length"], np.eye(6), infinity, omega, added, damping,
        stored["panels"],
    )  # fmt: skip


def picture(stored: dict[str, Any]) -> Figure:
    """Half-sphere, memory and waves."""
    with look():
        drawn, axes = figure(7.4, 2, 2)
        drawn.set_facecolor("white")
        _draw_sphere(axes[0, 0], stored["sphere"])
        _draw_memory(axes[0, 1], afloat(stored["usv"]))
        _draw_waves(axes[1, 0], stored["waves"])
        _draw_drift(axes[1, 1], stored["waves"])
    return drawn


def _draw_sphere(axes: Any, rows: list[dict[str, Any]]) -> None:
    for motion, colour in (("heave", COLOURS[0]), ("surge", COLOURS[1])):
        own = [r for r in rows if r["motion"] == motion]
        ka = [r["ka"] for r in own]
        axes.plot(ka, [r["A"] for r in own], color=colour, label=f"{motion}, added mass")
        axes.plot(ka, [r["B"] for r in own], "--", color=colour, label=f"{motion}, damping")
        axes.plot(ADDED[motion].keys(), ADDED[motion].values(), "o", ms=4, color=colour)
        axes.plot(DAMPING[motion].keys(), DAMPING[motion].values(), "o", ms=4, color=colour, mfc="white")
    axes.set(title="Half-sphere; dots: Hulme (1982)", xlabel="wave number times radius", ylim=(0, 1))
    axes.legend(fontsize=8, ncols=2)


def _draw_memory(axes: Any, hull: FloatingHull) -> None:
    fine = np.geomspace(hull.omega[0], hull.omega[-1], 200)
    for i, colour in ((2, COLOURS[0]), (1, COLOURS[1])):
        axes.plot(hull.omega, hull.damping[:, i, i], "o", ms=4, color=colour, label=f"{MOTIONS[i]}, panels")
        for order, style in ((1, ":"), (2, "-")):
            memory = fit_memory(hull, (i,), order)  # type: ignore[arg-type]
            axes.plot(fine, memory.kernel(i, fine).real, style, color=colour, label=f"order {order}")
    axes.set(title="Surface vehicle: radiation damping, kg/s", xlabel="rad/s", ylim=(0, 950))
    axes.legend(fontsize=8, ncols=2)


def _draw_waves(axes: Any, waves: list[dict[str, Any]]) -> None:
    for wave, colour in zip(waves, COLOURS, strict=False):
        degrees = np.degrees(wave["headings"])
        axes.plot(degrees, np.array(wave["motion"])[:, 2], color=colour, label=f"{wave['omega']:g} rad/s")
        axes.plot(degrees, np.array(wave["motion"])[:, 4], "--", color=colour)
    axes.set(
        title="Heave, m/m, and pitch (dashed), rad/m", xlabel="heading of the wave from the bow, degrees"
    )
    axes.set_xticks(range(0, 181, 45))
    axes.legend(fontsize=8)


def _draw_drift(axes: Any, waves: list[dict[str, Any]]) -> None:
    axes.axhline(0.0, color=FAINT, lw=0.8)
    for wave, colour in zip(waves, COLOURS, strict=False):
        degrees = np.degrees(wave["headings"])
        axes.plot(degrees, np.array(wave["drift"])[:, 0], color=colour, label=f"{wave['omega']:g} rad/s")
        axes.plot(degrees, np.array(wave["drift"])[:, 1], "--", color=colour)
    axes.set(title="Mean drift ahead and to starboard (dashed), N/m²", yscale="symlog")
    axes.set(xlabel="heading of the wave from the bow, degrees")
    axes.set_xticks(range(0, 181, 45))
    axes.legend(fontsize=8)


def page(stored: dict[str, Any]) -> str:
    """The whole page."""
    text = TEXT.read_text(encoding="utf-8")
    tables = {
        "{sphere}": _sphere_table(stored["sphere"]),
        "{cylinder}": _cylinder_table(stored["cylinder"]),
        "{memory}": _memory_table(stored),
    }
    for mark, lines in tables.items():
        text = text.replace(mark, "\n".join(lines))
    usv = stored["usv"]
    missed = ", ".join(f"{100 * w['missed']:.1f}%" for w in stored["waves"])
    numbers = {f"{{{n}}}": stored[n] for n in ("sphere_panels", "cylinder_panels")} | {
        "{panels}": usv["panels"]
    }
    for mark, value in (numbers | {"{draught}": f"{usv['draught']:.3f}", "{missed}": missed}).items():
        text = text.replace(mark, str(value))
    return text


def _sphere_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    yield "| motion | k a | added mass | Hulme | damping | Hulme |"
    yield "|---|---|---|---|---|---|"
    for r in rows:
        damping = DAMPING[r["motion"]].get(r["ka"])
        shown = "–" if damping is None else f"{damping:.4f}"
        yield (
            f"| {r['motion']} | {r['ka']:g} | {r['A']:.4f} | {ADDED[r['motion']][r['ka']]:.4f} | "
            f"{r['B']:.4f} | {shown} |"
        )


def _cylinder_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    yield "| motion | rad/s | added mass | WAMIT | damping | WAMIT | excitation | WAMIT |"
    yield "|---|---|---|---|---|---|---|---|"
    for r in rows:
        pairs = " | ".join(f"{v:.3g} | {w:.3g}" for v, w in zip(r["values"], r["wamit"], strict=True))
        yield f"| {r['motion']} | {r['omega']:g} | {pairs} |"


def _memory_table(stored: dict[str, Any]) -> Iterator[str]:
    hull = afloat(stored["usv"])
    first, second = (fit_memory(hull, range(6), order) for order in (1, 2))  # type: ignore[arg-type]
    yield "| motion | one state: unexplained | two states: unexplained | frequency | time |"
    yield "|---|---|---|---|---|"
    for i in second.stiffness:
        yield (
            f"| {MOTIONS[i]} | {100 * first.error[i]:.0f}% | {100 * second.error[i]:.0f}% | "
            f"{second.frequency[i]:.2f} rad/s | {second.time[i]:.3f} s |"
        )


def main(arguments: list[str] | None = None) -> int:
    """Measure and make the page; 0 when all went well, 2 without capytaine."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shape.floating", description=__doc__)
    parser.add_argument("what", choices=("run", "page"), help="compute, or make the page of stored results")
    parser.add_argument("--panels", type=int, default=1600, help="of a whole hull (default %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("docs"), help="default: %(default)s")
    options = parser.parse_args(arguments)
    if options.what == "run":
        try:
            stored = measure(options.panels, progress_line("hulls"))
        except UndertowError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        clear()
        write_whole(RESULTS, json.dumps(stored, default=float) + "\n")
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    save_png(picture(stored), options.out / "images" / "floating.png")
    write_whole(options.out / "floating.md", page(stored))
    return 0


if __name__ == "__main__":
    sys.exit(main())
