"""Find mistakes in logs and in how they are read, before you blame the physics.

The doctor checks the clock and the samples, the rate of the pose against the body velocities, and the motion
against the commands. Where they disagree, it tries the usual mistakes one by one: degrees for radians, mm/s,
knots or feet for SI, milliseconds for seconds, ENU for NED, FLU for FRD, a flipped axis, velocities
north-east-down or through the water, swapped or reversed thrusters, commands in percent, late or a thousand
times too large, the dry mass. If pose and velocity are wrong in the same way, or one of them is missing, the
force that the motion requires and the size of the vehicle decide. A mistake is reported only if correcting it
explains the log, with the line of the mapping file that corrects it. Checks that were impossible for lack of
velocities or of a pose are listed.

    undertow doctor rov.toml run1.csv run2.csv --map log.toml --mend mended.toml

might print

    mistake: psi is in degrees, read as radians: when corrected, the mismatch between pose rate and velocity
             changes: x, y 104% → 0.02%, psi 97% → < 0.01% of the motion (mean square; noise 0.14%)
        in log.toml:
            [columns]
            heading = { channel = "psi", unit = "deg" }

and `undertow diagnose rov.toml run1.csv run2.csv --map mended.toml` continues from there. All other findings
are warnings (a late velocity sensor, or one away from the origin, a motion never excited) or notes.

Every command that fits parameters to logs runs the quick checks first: an impossible log is refused, with the
line that corrects it, unless --trust-log is given.

The exit code is 0 if no mistake was found, 1 if there are mistakes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from undertow.cli._terminal import show_finding

from .._options import JsonFileOption, VehicleArgument, bundled
from .._terminal import console, progress, say, section, table, write_files
from ._logs import LogsArgument, ReadOptions, say_long

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.identification.doctor.examine import Examined
    from undertow.identification.findings import DofExcitation, Examination
    from undertow.identification.logs.mapping import LogMapping

_PLOT = typer.Option(
    metavar="OUT.png",
    help="Draw pose rates against velocities, before and after correction; for vehicle logs, the part "
    "that is used.",
)
_MEND = typer.Option(metavar="OUT.toml", help="Write a mapping file with the mistakes corrected.")


@bundled
def doctor(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: ReadOptions,
    json: JsonFileOption = None,
    plot: Annotated[Path | None, _PLOT] = None,
    mend: Annotated[Path | None, _MEND] = None,
) -> int:
    from undertow.files import check_writable
    from undertow.identification.doctor.examine import examine
    from undertow.identification.long_logs.choosing import EXAMINE

    check_writable(json, plot, mend, inputs=[vehicle, *logs, *options.files])
    loaded = options.load(vehicle, logs, in_any_order=True, budget=EXAMINE)
    model, runs = loaded.vehicle, loaded.runs
    with progress("examining") as report:
        examined = examine(model, runs, mapping=options.mapping, report=report)
    long = loaded.checked()
    result = examined.result.model_copy(update={"long_logs": long})
    say_long(long)
    show(result, options.map)

    def draw(_: Path) -> Figure:
        from undertow.identification.report.pictures import rates_picture

        return rates_picture(examined, model, () if options.map else loaded.field_logs)

    write_files(
        (json, result.to_json()),
        (mend, lambda _: mended_mapping(examined, options.map, runs[0].mapping)),
        (plot, draw),
    )
    return 1 if result.mistakes else 0


def show(result: Examination, map: Path | None) -> None:
    """Print findings, the most serious first, then excitation, then the conclusion."""
    for finding in result.findings:
        show_finding(finding, map)
    section("Excitation", table(_HEAD, [_row(e) for e in result.excitation]))
    console().print()
    say(verdict(result), "bold")


def verdict(result: Examination) -> str:
    """One line on the whole."""
    count = len(result.mistakes)
    warned = sum(f.severity == "warning" for f in result.findings)
    others = f", {warned} warning{'s' * (warned != 1)}" if warned else ""
    if not count:
        return f"no mistake found in how the logs are read{others} ({result.seconds:.1f} s)"
    first = result.mistakes[0].clause(result.runs)
    return f"{count} mistake{'s' * (count != 1)}{others}; first to correct: {first} ({result.seconds:.1f} s)"


_HEAD = ("motion", "rms", "noise", "moving", "one way", "reversals", "command range")


def _row(e: DofExcitation) -> tuple[str, ...]:
    span = "" if e.command_range is None else f"{e.command_range:.0%}"
    numbers = (f"{e.rms:.3g} {e.unit}", f"{e.noise:.2g}", f"{e.moving:.0%}", f"{e.positive:.0%}")
    return f"{e.degree_of_freedom} ({e.velocity})", *numbers, str(e.reversals), span


def mended_mapping(examined: Examined, map: Path | None, known: LogMapping | None) -> str:
    """The mapping file with all mistakes mended; comments and order of the old one are kept.

    Without a file, what the format of the log is `known` to mean is written out and mended.
    """
    from undertow.files import read_text
    from undertow.identification.logs.mapping import LogMapping, into_file, mapping_text

    given = read_text(map, "mapping file") if map else mapping_text(known or LogMapping())
    return into_file(given, examined.edits)
