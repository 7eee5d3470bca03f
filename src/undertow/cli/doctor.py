"""Find mistakes in logs and in how they are read, before physics is blamed for them.

Looked at are the clock and the samples, the rate of the pose against the body velocities, and the motion
against the commands. Where they disagree, the usual mistakes are undone one after the other: degrees for
radians, mm/s, knots or feet for SI, milliseconds for seconds, ENU for NED, FLU for FRD, a flipped axis,
velocities north-east-down or through the water, swapped or reversed thrusters, commands in percent, late or
a thousand times too large, the dry mass. Where pose and velocity are wrong alike, or one of them is missing,
the force that the motion needs and the size of the vehicle tell. A mistake is told only where undoing it
explains the log; with it comes the line for the mapping file that mends it. What could not be looked at, for
want of velocities or of a pose, is noted.

    undertow doctor rov.toml run1.csv run2.csv --map log.toml --mend mended.toml

might print

    mistake: psi is in degrees, read as radians: undone, the mismatch of pose rate and velocity of x, y
             104 % → 0.02 %, of psi 97 % → < 0.01 % of the motion (mean square; noise 0.14 %)
        in log.toml:
            [columns]
            heading = { channel = "psi", unit = "deg" }

and `undertow diagnose rov.toml run1.csv run2.csv --map mended.toml` goes on from there. What else is found
are warnings (a velocity sensor that is late or off the origin, a motion never excited) and notes.

The quick ones of these checks stand before every command that fits to logs: what cannot be is refused there,
with the line that mends it, unless --trust-log is given.

The exit code is 0 when no mistake was found, 1 when there are mistakes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from undertow.cli._vehicle_and_logs import (
    EffectsOption,
    FillOption,
    FromOption,
    LogsArgument,
    MapOption,
    ToOption,
    VehicleArgument,
)

_JSON = typer.Option("--json", metavar="OUT", help="Write the whole result as JSON.")
_PLOT = typer.Option(
    "--plot", metavar="OUT.png", help="Draw pose rates against velocities, as given and mended."
)
_MEND = typer.Option("--mend", metavar="OUT.toml", help="Write the mapping file with the mistakes mended.")


def doctor(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    map: MapOption = None,
    effects: EffectsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    fill: FillOption = None,
    json: Annotated[Path | None, _JSON] = None,
    plot: Annotated[Path | None, _PLOT] = None,
    mend: Annotated[Path | None, _MEND] = None,
) -> int:
    from undertow.cli._examination import show, write
    from undertow.cli._progress import progress
    from undertow.cli._vehicle_and_logs import load
    from undertow.files import check_writable
    from undertow.identification.doctor import examine
    from undertow.identification.logs import Mapping, read_mapping

    read: list[str | Path] = [vehicle, *logs, *(effects or []), *([map] if map else [])]
    check_writable(json, plot, mend, inputs=read)
    mapping = Mapping() if map is None else read_mapping(map)
    loaded = load(
        vehicle, logs, map=map, effects=effects, window=(since, until), fill=fill, in_any_order=True
    )
    with progress("examining") as tell:
        examined = examine(loaded.vehicle, loaded.train, mapping=mapping, report=tell)
    show(examined.result, map)
    write(examined, loaded.vehicle, map, json=json, plot=plot, mend=mend)
    return 1 if examined.result.mistakes else 0
