"""Estimate added mass and damping from forced motion by the paper's chain: filters, then least squares.

Each log holds one motion (surge, heave, yaw ...) that a known force drives, as a towing tank or a flow
solver gives it: a velocity, the force tau_X (Y, Z, K, M, N) or the thrusters, and if possible the
acceleration u_dot (v_dot ...), else velocities are differentiated. Velocity and acceleration are smoothed by
Savitzky-Golay filters in eleven ways (--cases, Tables 1 to 3 of the paper), and added mass and damping follow
by least squares for each of them. A vehicle with values for forward and backward motion gets each from the
logs that go that way.

    undertow identify mini-auv surge.csv heave.csv yaw.csv --cases all --out identified.toml

Of the cases whose estimates are all physical, the one with the least residual variance is taken.

Logs of any length are read in parts, in constant memory and with the same answer: those of more than 200 MB
(unpacked) by themselves where that can be done, shorter ones with --stream.

    undertow identify mini-auv week.parquet --stream

This is the baseline that others are held against: filtering the motion and not the force biases the
estimates, and the errors that it states take smoothed samples as independent. `undertow fit` has neither
fault.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from undertow.cli._vehicle_and_logs import (
    EffectsOption,
    FillOption,
    FromOption,
    InPlaceOption,
    LogsArgument,
    MapOption,
    OutOption,
    ToOption,
    TrustOption,
    VehicleArgument,
)

if TYPE_CHECKING:
    from undertow.cli._identifying import Identified
    from undertow.identification.least_squares.cases import Edges

_METHOD = typer.Option("--method", help="Savitzky-Golay filters, then least squares.")
_CASES = typer.Option("--cases", metavar="all|N,N", help="Ways to filter, by their number in the paper.")
_EDGES = typer.Option("--edges", help="What filters do at the ends: interp is MATLAB's sgolayfilt.")
_STREAM = typer.Option("--stream", help="Read the logs in parts, however short they are.")
_LONG = 200_000_000
_JSON = typer.Option("--json", metavar="FILE.json", help="Write all numbers.")


def identify(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    method: Annotated[Literal["sg-ls"], _METHOD] = "sg-ls",
    cases: Annotated[str, _CASES] = "all",
    edges: Annotated[Literal["interp", "drop", "nearest", "mirror", "constant", "wrap"], _EDGES] = "interp",
    stream: Annotated[bool, _STREAM] = False,
    json: Annotated[Path | None, _JSON] = None,
    out: OutOption = None,
    in_place: InPlaceOption = False,
    map: MapOption = None,
    effects: EffectsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> None:
    from undertow.cli._adding import target_of
    from undertow.cli._identifying import show, write, written
    from undertow.files import check_writable, together, write_whole

    target = target_of(vehicle, out, in_place)
    read: list[str | Path] = [*logs, *(effects or []), *([map] if map else [])]
    check_writable(target, json, inputs=[*read, *([] if in_place else [vehicle])])
    given: dict[str, Any] = {"map": map, "effects": effects, "window": (since, until), "fill": fill}
    path, done = _estimated(vehicle, logs, cases, edges, stream, given, trust_log)
    show(done)
    with together():
        if json is not None:
            write_whole(json, written(done))
        if target is not None:
            write(done, path, target)
    typer.echo(
        "no vehicle file was written: --out NEW.toml or --in-place does that"
        if target is None
        else f"wrote {target}"
    )


def _estimated(
    vehicle: str,
    logs: list[Path],
    cases: str,
    edges: Edges,
    stream: bool,
    given: dict[str, Any],
    trust_log: bool,
) -> tuple[Path, Identified]:
    """File of the vehicle and estimates; from parts of the logs where that is asked for or they are long."""
    from undertow.cli._identifying import identified, identified_in_parts
    from undertow.cli._progress import progress
    from undertow.cli._vehicle_and_logs import load, load_in_parts
    from undertow.identification.logs.chunks import NeedsWhole, size_of

    if stream or sum(map(size_of, logs)) > _LONG:
        model, path, long = load_in_parts(vehicle, logs, **given)
        try:
            with progress("reading logs") as tell:
                return path, identified_in_parts(model, long, cases, edges, tell, trust_log=trust_log)
        except NeedsWhole:
            if stream:
                raise
    loaded = load(vehicle, logs, one_motion=True, **given)
    return loaded.path, identified(loaded.vehicle, loaded.train, cases, edges, trust_log=trust_log)
