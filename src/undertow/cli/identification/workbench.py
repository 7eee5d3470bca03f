"""Work on logs and model in a local web page: where the model fails, what is missing, and what corrects it.

The page shows the logs with the doctor's findings, the error map, the candidate effects and how each of them
changes the error, and the parameters; buttons add and undo effects. The session is kept in a folder
(VEHICLE.workbench, or that of --session), with the vehicle files made on the way, and resumed at the next
start.

    undertow workbench rov.toml run1.csv run2.csv --validation run3.csv

The page is served on this machine only (127.0.0.1), at an address with a token that is printed; requests
without it are refused, and nothing is fetched from outside. It needs NiceGUI: pip install
"undertow[workbench]".
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .._options import VehicleArgument, bundled
from .._terminal import progress, say
from ._logs import LogOptions, LogsArgument, ValidationOption

_SESSION = typer.Option(metavar="FOLDER", help="Folder for the session.")
_BROWSER = typer.Option("--browser/--no-browser", help="Open the page in the browser.")


@bundled
def workbench(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: LogOptions,
    validation: ValidationOption = None,
    session: Annotated[Path | None, _SESSION] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the page.")] = 8080,
    browser: Annotated[bool, _BROWSER] = True,
) -> None:
    from undertow.workbench.bench import Bench, require_nicegui, require_port
    from undertow.workbench.session import LogChoice, Session

    require_nicegui()
    require_port(port)

    from undertow.workbench.server import serve

    span = options.since, options.until
    # Whole paths, so that the session can go on from any folder.
    wanted = Session(
        vehicle=str(Path(vehicle).absolute()) if Path(vehicle).is_file() else vehicle,
        logs=[
            *(LogChoice.within(path.absolute(), "train", span) for path in logs),
            *(LogChoice.within(path.absolute(), "judge", span) for path in validation or []),
        ],
        effects=[str(path.absolute()) for path in options.effects or []],
        mapping="" if options.map is None else str(options.map.absolute()),
        fill=options.fill,
        trust_log=options.trust_log,
    )
    folder = session or Path(f"{Path(vehicle).stem}.workbench")
    with progress("reading the vehicle", None):
        bench = Bench.open(folder, wanted)
    say(f"the session is kept in {folder}; Ctrl-C ends the workbench")
    serve(bench, port, show=browser, said=say)
