"""Plan the manoeuvre that best determines badly known parameters, or best tells rival effects apart.

Manoeuvres of many kinds (steps, doublets, multisines, random steps, chirps, reversals, coast-downs, sweeps,
circles, zigzags; of all motions together, in turn, or actuator by actuator) are simulated with the model and
judged by what a log of them would say, together with what the vehicle file and the logs say already. Every
command stays within its limit, the predicted motion within --max-..., and the ends are smooth.

    undertow plan rov.toml run1.csv --duration 90 --out plan.csv --picture plan.png

    undertow plan rov.toml run1.csv --goal separate --between ocean_current,constant_force --out plan.csv

    undertow diagnose rov.toml run1.csv --json found.json

    undertow plan rov.toml run1.csv --goal separate --diagnosis found.json --out plan.csv

The goal "parameters" minimises the volume of the confidence region of the parameters marked estimate = true
(D-optimal). The goal "separate" maximises the difference between the predictions of rival models after each
has been refitted to the other (T-optimal); their values come from a fit to the logs, from the diagnosis, or
are of a typical size. Both are best for the present values: fit to the new log, and plan again.

The CSV has a column t in s and one for each command, named as in the vehicle file, in the unit of the command
(N for a thruster unless its thrust_per_command says otherwise; N or N m for a known force). It is to be flown
open loop from rest; each row is held until the next. The same --seed gives the same plan.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from undertow.cli._vehicle_and_logs import (
    EffectsOption,
    FillOption,
    FromOption,
    MapOption,
    ToOption,
    TrustOption,
    VehicleArgument,
)

_LOGS = typer.Argument(metavar="LOG", help="Logs that exist already: CSV, CSV.gz or Parquet.")
_GOAL = typer.Option("--goal", help="Determine parameters, or tell models apart.")
_BETWEEN = typer.Option(
    "--between",
    metavar="ID,ID[,ID]",
    help='Effects to be told apart; "none" is the model as it is, a+b has both.',
)
_DIAGNOSIS = typer.Option(
    "--diagnosis", metavar="FILE.json", help="Take the effects to be told apart from a diagnosis."
)
_ONLY = typer.Option("--only", metavar="NAME,NAME", help="Parameters that matter; all by default.")
_LIMIT = typer.Option(
    "--limit",
    metavar="VALUE|NAME=VALUE",
    help="Largest command, of all or of one.",
    show_default="vehicle file, or largest in the logs",
)
_NOISE = typer.Option(
    "--noise",
    metavar="NAME=VALUE",
    help="Noise of a channel (SI), none if it is not measured.",
    show_default="as in the logs, or 0.02 m, 0.01 rad, 0.01 m/s, 0.005 rad/s",
)
_DEPTH = typer.Option(
    "--depth", metavar="M", help="Depth at the start.", show_default="median of the logs, or 0"
)
_TRIES = typer.Option(
    "--tries",
    help="Manoeuvres to be judged, at least one of each kind.",
    min=1,
    max=100_000,
    show_default="some ten seconds of them",
)


def plan(
    vehicle: VehicleArgument,
    logs: Annotated[list[Path] | None, _LOGS] = None,
    goal: Annotated[Literal["parameters", "separate"] | None, _GOAL] = None,
    between: Annotated[list[str] | None, _BETWEEN] = None,
    diagnosis: Annotated[Path | None, _DIAGNOSIS] = None,
    only: Annotated[list[str] | None, _ONLY] = None,
    duration: Annotated[float, typer.Option("--duration", metavar="SECONDS", help="Length.")] = 60.0,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Samples per second.")] = 20.0,
    limit: Annotated[list[str] | None, _LIMIT] = None,
    max_speed: Annotated[float | None, typer.Option(metavar="M/S", help="Largest speed.")] = None,
    max_rate: Annotated[float, typer.Option(metavar="DEG/S", help="Largest angular rate.")] = 60.0,
    max_depth_change: Annotated[float, typer.Option(metavar="M", help="Largest change of depth.")] = 5.0,
    max_tilt: Annotated[float, typer.Option(metavar="DEG", help="Largest roll and pitch.")] = 45.0,
    max_distance: Annotated[
        float | None, typer.Option(metavar="M", help="Largest horizontal distance from the start.")
    ] = None,
    depth: Annotated[float | None, _DEPTH] = None,
    noise: Annotated[list[str] | None, _NOISE] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of the random search.", min=0)] = 0,
    tries: Annotated[int | None, _TRIES] = None,
    out: Annotated[Path | None, typer.Option(metavar="OUT.csv", help="Write the commands.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="OUT.png", help="Draw commands, motions and errors.")
    ] = None,
    json: Annotated[Path | None, typer.Option(metavar="OUT.json", help="Write the whole result.")] = None,
    map: MapOption = None,
    effects: EffectsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> None:
    from undertow.cli._planning import Wish, asked_of, planned_for, show, write
    from undertow.cli._progress import progress
    from undertow.cli._vehicle_and_logs import load
    from undertow.files import check_writable

    read: list[str | Path] = [vehicle, *(logs or []), *(effects or []), *filter(None, (map, diagnosis))]
    check_writable(out, picture, json, inputs=read)
    wish = Wish(goal, between or [], diagnosis, only or [], effects or [])
    largest = {"speed": max_speed, "rate": max_rate, "tilt": max_tilt}
    drift = {"depth": max_depth_change, "distance": max_distance}
    request = asked_of(largest | drift, limit or [], noise or [], (duration, rate), (depth, seed, tries))
    loaded = load(
        vehicle, logs or [], map=map, effects=effects, window=(since, until), fill=fill, to_fit=bool(logs)
    )
    with progress("planning") as tell:
        done = planned_for(wish, loaded.vehicle, loaded.train, request, tell, trust_log=trust_log)
    show(done)
    write(done, out=out, picture=picture, json=json)
