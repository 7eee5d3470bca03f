"""Years of logs from many vehicles: what changed month by month, and how sure simulations are.

The work is spread over processes of this machine, or over any Dask cluster (--scheduler). Needs
pip install "undertow[fleet]".

    undertow fleet diagnose rov.toml 'logs/**/*.parquet' --out fleet-2026
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, FillOption, MapOption, TrustOption

app = typer.Typer(add_completion=False)

_SCHEDULER = typer.Option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler such as tcp://10.0.0.1:8786; it must see the same paths.",
)
_WORKERS = typer.Option(
    "--workers", metavar="N", min=0, help="Processes on this machine; 0: in this process, without Dask.",
    show_default="one for each processor",
)  # fmt: skip
_PATIENCE = typer.Option(
    "--patience", metavar="SECONDS", min=1.0, help="Give up what is left when no worker answers for so long."
)
_LISTEN = typer.Option(
    "--listen",
    metavar="ADDRESS",
    help="Address of this machine that its cluster listens on; whoever reaches it can run code here.",
    show_default="127.0.0.1, for this machine alone",
)
SchedulerOption = Annotated[str | None, _SCHEDULER]
WorkersOption = Annotated[int | None, _WORKERS]
PatienceOption = Annotated[float, _PATIENCE]
ListenOption = Annotated[str | None, _LISTEN]
_FLEET_VEHICLE = typer.Argument(
    metavar="VEHICLE", help="Vehicle file or bundled vehicle; {vehicle} in a path stands for each name."
)
_PATTERNS = typer.Argument(metavar="LOGS", help="Patterns of Parquet files, or folders; quote the patterns.")
_OUT = typer.Option("--out", metavar="FOLDER", help="Folder for the report, and for results to go on from.")
_DAILY = typer.Option(
    "--daily",
    metavar="EFFECT",
    help="Effect that every log has a value of its own for; may be repeated.",
    show_default="ocean_current, net_buoyancy, constant_force",
)
_PASSES = typer.Option(
    "--passes", min=1, max=5, help="Linearise so often, each time at what was found before."
)


@app.callback()
def _fleet() -> None:
    pass


@app.command()
def diagnose(
    vehicle: Annotated[str, _FLEET_VEHICLE],
    logs: Annotated[list[str], _PATTERNS],
    out: Annotated[Path, _OUT] = Path("fleet-results"),
    scheduler: SchedulerOption = None,
    workers: WorkersOption = None,
    daily: Annotated[list[str] | None, _DAILY] = None,
    passes: Annotated[int, _PASSES] = 1,
    patience: PatienceOption = 900.0,
    listen: ListenOption = None,
    map: MapOption = None,
    effects: EffectsOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> int:
    """A table for each vehicle and month: parameters, and which effect grew (fouling, thruster wear).

    Every Parquet file is the log of one vehicle and day: logs/vehicle=V/day=2026-05-01/part.parquet. Without
    such folders, columns `vehicle` and `day` say so, or the folder's name (the vehicle) with a date in the
    file's name or a time that counts from 1970.

    \b
        undertow fleet diagnose rov.toml 'logs/**/*.parquet' --out fleet-2026
        undertow fleet diagnose 'fitted/{vehicle}.toml' logs --scheduler tcp://10.0.0.1:8786

    Each log is reduced to a small table that is kept under --out by the content of the file: a second run
    does what is missing only. A change is named only where it stands out of the scatter from day to day, with
    all that was looked at counted in (1 % for a single false name in the whole report), and where nothing
    else that was tried explains it; else the report says that it cannot tell.

    Exit code 0: all files count; 1: some could not be used, and are named; 2: a mistake in the input.
    """
    from undertow.cli._fleet import diagnosed
    from undertow.fleet.engine import engine

    with engine(scheduler, workers, patience, listen) as doing:
        return diagnosed(doing, vehicle, logs, out, daily, passes, map, effects, fill, trust_log)


@app.command()
def rollouts(
    vehicle: Annotated[
        str, typer.Argument(metavar="VEHICLE_FIT", help="Vehicle file that a fit has written.")
    ],
    logs: Annotated[list[Path], typer.Argument(metavar="LOG", help="Logs: CSV, CSV.gz or Parquet.")],
    count: Annotated[
        int, typer.Option("--count", metavar="N", min=10, help="Rollouts of each window.")
    ] = 500,
    horizon: Annotated[
        float, typer.Option("--horizon", metavar="SECONDS", min=0.01, help="Length of a window.")
    ] = 10.0,
    coverage: Annotated[
        float, typer.Option("--coverage", metavar="SHARE", min=0.01, max=0.999, help="Width of the band.")
    ] = 0.9,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the drawn parameters.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.parquet", help="Write the bands of all channels.")
    ] = None,
    scheduler: SchedulerOption = None,
    workers: WorkersOption = None,
    patience: PatienceOption = 900.0,
    listen: ListenOption = None,
    map: MapOption = None,
    effects: EffectsOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> int:
    """Simulate logs many times with parameters drawn from what a fit left open, and hold them to the bands.

    Parameters are drawn from the covariance that a fit wrote into the vehicle file (or stated standard
    deviations), within physical bounds. Every window of a log starts from the measured motion and is driven
    by the logged commands. The table says how much of the measurement lies within the band of the rollouts,
    with the noise of the sensors on top.

    \b
        undertow fit rov.toml run1.csv run2.csv --out fitted.toml
        undertow fleet rollouts fitted.toml run3.csv --count 1000 --horizon 20 --out bands.parquet

    Exit code 0: all rollouts count; 1: some diverged or some logs could not be used, and are named; 2: a
    mistake in the input.
    """
    from undertow.cli._rollouts import rolled
    from undertow.fleet.engine import engine

    with engine(scheduler, workers, patience, listen) as doing:
        return rolled(
            doing, vehicle, logs, count, horizon, coverage, seed, out, map, effects, fill, trust_log
        )
