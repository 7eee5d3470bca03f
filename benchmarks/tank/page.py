"""The text of docs/tank.md."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .bodies import BODIES
from .chain import table

_TEXT = Path(__file__).parent / "page.md"
CHAIN = Path(__file__).parent / "chain.json"
_WAYS = {0: "", 1: " forward", -1: " backward"}
_UNITS = {"X": "kg", "Y": "kg", "Z": "kg", "K": "kg m²", "M": "kg m²", "N": "kg m²"}


def page(rows: Sequence[dict[str, Any]]) -> str:
    """The whole page; `rows` are those of results.json."""
    text = _TEXT.read_text(encoding="utf-8")
    # What the paper's forces say of the AUV stands in the table of its chain.
    rows = [r for r in rows if not r["body"].endswith("-paper")]
    hull = [r for r in rows if r["body"].startswith("auv")]
    added = [r for r in rows if r["name"].endswith("dot") and r["body"] != "box-steps" and r not in hull]
    drag = [r for r in rows if r["name"] == "Cd"]
    rms = {r["body"]: r for r in rows if r["name"] == "rms"}
    (wake,) = (r for r in rows if r["name"] == "wake")
    made = {
        "bare": _off(rms["box-bare"]),
        "forced": _off(rms["box-forced"]),
        "speed": f"{1000 * rms['box-bare']['speed']:.0f}",
        "wake": ", ".join(f"{m:.2f} ± {s:.2f}" for m, s in zip(wake["mean"], wake["rms"], strict=True)),
        "chain": "\n".join(table(json.loads(CHAIN.read_text(encoding="utf-8")))),
        "auv": "\n".join(_auv(hull)),
        "added": "\n".join(_added(added)),
        "drag": "\n".join(_drag(drag)),
    }
    for name, words in made.items():
        text = text.replace(f"{{{name}}}", words)
    return text


def _off(row: dict[str, Any]) -> str:
    return ", ".join(f"{1000 * off:.1f}" for off in row["off"])


def _title(row: dict[str, Any]) -> str:
    motion = f", {row['motion']}" if row["body"].startswith("auv") and "motion" in row else ""
    return BODIES[row["body"]].title + motion + _WAYS[row["direction"]]


def _auv(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """What the AUV has in each motion and direction, by prescribed motion."""
    yield "| motion | added mass | panels | grid index | linear damping | quadratic damping |"
    yield "|---|---|---|---|---|---|"
    motions = {"X": "surge", "Z": "heave", "N": "yaw"}
    for r in (r for r in rows if r["name"].endswith("dot")):
        own = {o["name"]: o for o in rows if (o["body"], o["direction"]) == (r["body"], r["direction"])}
        letter, speed = r["name"][0], r["name"][2]
        names = (r["name"], f"{letter}_{speed}", f"{letter}_{speed}abs{speed}")
        found = [f"{own[n]['value']:.4g} ± {own[n]['sigma']:.2g}" if n in own else "–" for n in names]
        start = f"| {motions[letter]}{_WAYS[r['direction']]} | {found[0]} {_UNITS[letter]} | {r['truth']:.4g}"
        yield f"{start} | {100 * r['grid']['index'] / r['value']:.1f}% | {found[1]} | {found[2]} |"


def _effort(row: dict[str, Any]) -> str:
    return f"{', '.join(f'{c:,}' for c in row['cells'])} | {', '.join(f'{s:.0f}' for s in row['seconds'])}"


def _added(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    yield "| body | | tank | known | off by | grid index | sigma | cells | processor seconds |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for r in rows:
        known = f"{r['truth']:.4g} ({r['source']})" if r["truth"] else "–"
        off = f"{100 * (r['value'] / r['truth'] - 1):+.1f}%" if r["truth"] else "–"
        index, sigma = (f"{100 * x / r['value']:.1f}%" for x in (r["grid"]["index"], r["sigma"]))
        value = f"{r['value']:.4g} {_UNITS[r['name'][0]]}"
        yield f"| {_title(r)} | -{r['name']} | {value} | {known} | {off} | {index} | {sigma} | {_effort(r)} |"


def published(reynolds: float) -> float:
    """Standard drag coefficient of a sphere on its silhouette for Reynolds numbers from 20 to 260.

    Source: Clift, Grace and Weber (1978), Bubbles, Drops, and Particles, chapter 5.
    """
    return 24 / reynolds * (1 + 0.1935 * reynolds**0.6305)


# Drag coefficients of a circular cylinder by Reynolds number: Dennis and Chang (1970), Numerical solutions
# for steady flow past a circular cylinder at Reynolds numbers up to 100, J. Fluid Mech. 42, 471-489.
CYLINDER = {20: 2.045, 40: 1.522}


def known_drag(row: dict[str, Any]) -> float | None:
    """What was published of a drag coefficient."""
    if row["body"] in ("re100", "re200"):
        return published(row["reynolds"])
    return CYLINDER[round(row["reynolds"])] if row["body"] == "cylinder-drag" else None


def _drag(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    yield "| body | speed | Reynolds | C_d | published | off by | grid index | cells | processor seconds |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for r in rows:
        known = known_drag(r)
        shown = f"{known:.3f} | {100 * (r['value'] / known - 1):+.1f}%" if known else "– | –"
        index = f"{100 * r['grid']['index'] / r['value']:.1f}%"
        start = f"| {_title(r)} | {r['speed']:.3g} m/s | {r['reynolds']:.3g} | {r['value']:.3f} | "
        yield f"{start}{shown} | {index} | {_effort(r)} |"
