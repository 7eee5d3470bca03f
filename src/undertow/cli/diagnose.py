"""Find out which physical effect a model lacks, and write it into a new vehicle file.

Every effect of the catalogue is added to the model in turn and refitted with it; what counts is the error on
data that was kept aside: the logs given with --holdout, or stretches of the logs where none is given. The
answer is one of: nothing is missing (adequate), a missing effect with its parameters, a set of effects that
these data cannot tell apart, or unexplained.

Values that the vehicle file holds fixed (all that are not marked estimate = true) are tried as well: where
others explain more than any effect, the answer names them, and what is written has them fitted. What is
weighed and drawn (mass, inertia, weight, buoyancy and their centres) is taken as known; where that is wrong,
an effect says so: entrained_water, net_buoyancy, trim_offset.

On Linux all cores share the work, which changes no result; UNDERTOW_JOBS=1 in the environment keeps it to
one.

    undertow diagnose rov.toml run1.csv run2.csv --holdout run3.csv --report report.html --apply better.toml
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from undertow.cli._vehicle_and_logs import (
    EffectsOption,
    FillOption,
    FromOption,
    HoldoutOption,
    LogsArgument,
    MapOption,
    ToOption,
    TrustOption,
    VehicleArgument,
)


def diagnose(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    holdout: HoldoutOption = None,
    map: MapOption = None,
    effects: EffectsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
    false_alarms: Annotated[
        float,
        typer.Option(
            metavar="CHANCE",
            help="Chance of naming an effect where nothing is missing, 0.005 to 0.2.",
        ),
    ] = 0.01,
    json: Annotated[Path | None, typer.Option(metavar="OUT", help="Write the whole result as JSON.")] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="OUT.html", help="Write a report: one HTML file with all pictures.")
    ] = None,
    apply: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.toml",
            help="Write a vehicle file with the effects that were found, or with refitted values only.",
        ),
    ] = None,
) -> None:
    from undertow.cli._outcome import show, write_outcome
    from undertow.cli._progress import progress
    from undertow.cli._vehicle_and_logs import load
    from undertow.files import check_writable
    from undertow.identification.diagnosis.diagnose import check_false_alarms
    from undertow.identification.public import diagnose as run
    from undertow.model.catalogue import catalogue, load_effects, merge

    read: list[str | Path] = [vehicle, *logs, *(holdout or []), *(effects or []), *([map] if map else [])]
    check_false_alarms(false_alarms)
    check_writable(json, report, apply, inputs=read)
    loaded = load(
        vehicle, logs, holdout, map=map, effects=effects, window=(since, until), fill=fill, to_fit=True
    )
    known = merge(catalogue(), [cls for file in effects or [] for cls in load_effects(file)])
    with progress("looking for what is missing") as tell:
        outcome = run(
            loaded.vehicle,
            loaded.train,
            loaded.holdout,
            known=known,
            report=tell,
            false_alarms=false_alarms,
            trust_log=trust_log,
        )
    show(outcome)
    write_outcome(outcome, loaded.path, json=json, report=report, apply=apply)
