"""What `undertow doctor` prints and writes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from undertow.cli._show import console, section, table, text

if TYPE_CHECKING:
    from undertow.identification.doctor import Examination, Examined, Excited, Finding
    from undertow.model.vehicle import Vehicle

_STYLES = {"mistake": "bold red", "warning": "yellow", "note": "dim"}
_INDENT = "    "


def show(result: Examination, map: Path | None) -> None:
    """Print findings, the most serious first, then excitation, then what it comes to."""
    for finding in result.findings:
        show_finding(finding, map)
    section("Excitation", table(_HEAD, [_row(e) for e in result.excitation]))
    console().print()
    console().print(text(verdict(result), "bold"), soft_wrap=True)


def show_finding(finding: Finding, map: Path | None, out: Any = None) -> None:
    """Print one finding with what mends it; `map` is the mapping file in use."""
    out = out or console()
    line = text(f"{finding.severity}: ", _STYLES[finding.severity])
    line.append(finding.text)
    out.print(line, soft_wrap=True)
    if finding.mapping:
        where = f"in {map}" if map else "in a mapping file (--map; undertow doctor --mend writes it)"
        out.print(text(f"{_INDENT}{where}:", "green"), soft_wrap=True)
        for row in finding.mapping.splitlines():
            out.print(text(f"{2 * _INDENT}{row}"), soft_wrap=True)
    if finding.vehicle:
        either = "or in" if finding.mapping else "in"
        out.print(text(f"{_INDENT}{either} the vehicle file: {finding.vehicle}", "green"), soft_wrap=True)
    for other in finding.alternatives:
        out.print(text(f"{_INDENT}not excluded: {other}"), soft_wrap=True)


def verdict(result: Examination) -> str:
    """One line on the whole."""
    count = len(result.mistakes)
    warned = sum(f.severity == "warning" for f in result.findings)
    others = f", {warned} warning{'s' * (warned != 1)}" if warned else ""
    if not count:
        return f"no mistake found in how the logs are read{others} ({result.seconds:.1f} s)"
    first = result.mistakes[0].text.partition(":")[0]
    return f"{count} mistake{'s' * (count != 1)}{others}; first of all: {first} ({result.seconds:.1f} s)"


_HEAD = ("motion", "rms", "noise", "moving", "one way", "reversals", "command range")


def _row(e: Excited) -> tuple[str, ...]:
    span = "" if e.command_range is None else f"{e.command_range:.0%}"
    numbers = (f"{e.rms:.3g} {e.unit}", f"{e.noise:.2g}", f"{e.moving:.0%}", f"{e.positive:.0%}")
    return (
        f"{e.degree_of_freedom} ({e.velocity})",
        *numbers,
        str(e.reversals),
        span,
    )


# --- files ------------------------------------------------------------------------------------
def write(
    examined: Examined,
    vehicle: Vehicle,
    map: Path | None,
    *,
    json: Path | None,
    plot: Path | None,
    mend: Path | None,
) -> None:
    """Write what was asked for, each file whole, and say where it is."""
    from undertow.files import together, write_whole

    texts: dict[Path, Any] = {}
    if json is not None:
        texts[json] = examined.result.model_dump_json(indent=1) + "\n"
    if mend is not None:
        texts[mend] = mended_mapping(examined, map)
    with together():
        for path, content in texts.items():
            write_whole(path, content)
        if plot is not None:
            _draw(examined, vehicle, plot)
    for written in filter(None, (json, mend, plot)):
        console().print(text(f"wrote {written}"))


def mended_mapping(examined: Examined, map: Path | None) -> str:
    """The mapping file with all mistakes mended; comments and order of the old one are kept."""
    from undertow.files import read_text
    from undertow.identification.doctor.mending import as_toml, into_file

    if map is None:
        return as_toml(examined.edits, whole=True) + "\n"
    return into_file(read_text(map, "mapping file"), examined.edits)


def _draw(examined: Examined, vehicle: Vehicle, path: Path) -> None:
    from undertow.identification.doctor.picture import rates_picture
    from undertow.identification.report.style import save_png

    save_png(rates_picture(examined, vehicle), path)
