"""Simulate a vehicle under a controller on its way to a goal.

Model, sensors, control law, schedule, thrust allocation and integrator (Runge-Kutta of fourth order) are
compiled into one call. The controller is sampled every --dt and its commands are held in between; with
--continuous it acts without sampling. Shown are settling time (2 %), overshoot, what is left at the end,
effort, and oscillations that last (amplitude and period). Several gain files are compared with each other.

    undertow simulate mini-auv paper-pd paper-pid paper-smc --to -1,1,1 --for 240 --figures figures

    undertow simulate mini-auv paper-pd --to -1,1,1,135deg --current 0.05,0 --noise x=0.01 --out log.csv

    undertow simulate rov.toml gains.toml --plant rov-as-identified.toml --to 5,0,2,0

The vehicle moves as VEHICLE says, unless --plant names another file: then the controller knows VEHICLE and
moves the other one. A set-point has x, y, z as far as the vehicle has them, and the heading if you wish;
without one it is taken from the direction of the set-point (--heading). Numbers are in SI unless they have a
unit: 135deg. A current, noise and pushes are not known to the controller.

--out writes a log that undertow itself reads: what the sensors report, and the mean of every command from one
row to the next. An interval --dt that is too long for the law is refused, and the limit is said. The exit
code is 1 if a run diverges: if the state is no number any more, a speed is beyond 100 m/s or 100 rad/s, which
nothing in water reaches, or the pose is farther from the start than twice that can lead. The tables, the log
and the pictures are of the run up to there. A run that has not settled yet has not diverged.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument

_GAINS = typer.Argument(metavar="GAINS", help="Gain files (TOML), or names of bundled ones (paper-pd ...).")
_TO = typer.Option("--to", metavar="X,Y,Z[,PSI]", help="Set-point.")
_FOR = typer.Option("--for", metavar="SECONDS", help="Length of the run.")
_DT = typer.Option("--dt", metavar="SECONDS", help="Sampling interval of the controller.")
_START = typer.Option("--from", metavar="X,Y,Z[,PSI]", help="Where the vehicle begins.", show_default="0")
_MOVING = typer.Option("--moving", metavar="NAME=VALUE", help="A velocity that it begins with, as u=0.2.")
_WITHOUT = typer.Option("--without", metavar="EFFECT", help="Leave an effect of the vehicle out.")
_PLANT = typer.Option("--plant", metavar="OTHER.toml", help="The vehicle that moves, if it is another one.")
_FILE = "gain file"
_ORDER = typer.Option("--order", help="Heading first, or all at once.", show_default=_FILE)
_HEADING = typer.Option("--heading", help="Heading to a set-point without one.", show_default=_FILE)
_GATE = typer.Option(
    "--gate", metavar="ANGLE", help="Error of the heading at which x and y begin.", show_default=_FILE
)
_INTEGRATORS = typer.Option("--integrators", help="When the integrals of x and y begin.", show_default=_FILE)
_SWAY = typer.Option("--sway", help="Add an ideal sway force, or leave that force out.", show_default=_FILE)
_CURRENT = typer.Option("--current", metavar="NORTH,EAST", help="Velocity of the water, m/s.")
_PUSH = typer.Option(
    "--push",
    metavar="AXIS=VALUE[:FROM:TO]",
    help="A force (X, Y, Z) or moment (K, M, N), for all the time or a part.",
)
_NOISE = typer.Option(
    "--noise", metavar="NAME=VALUE", help="Standard deviation of a sensor (x=0.01, psi=0.5deg)."
)
_SEED = typer.Option("--seed", help="Of the noise.")
_CONTINUOUS = typer.Option(
    "--continuous", help="The law acts without sampling, in Runge-Kutta steps of at most --dt."
)
_LOG = typer.Option(
    "--log", metavar="SECONDS", help="Interval of the rows of --out.", show_default="~5000 rows"
)
_OUT = typer.Option("--out", metavar="LOG.csv", help="Write the run as a log.")
_FIGURES = typer.Option("--figures", metavar="FOLDER", help="Write pictures (PNG) into this folder.")
_JSON = typer.Option("--json", metavar="FILE", help="Write the result as JSON.")


def simulate(
    vehicle: VehicleArgument,
    gains: Annotated[list[str], _GAINS],
    to: Annotated[str, _TO],
    duration: Annotated[float, _FOR] = 240.0,
    dt: Annotated[float, _DT] = 0.001,
    start: Annotated[str | None, _START] = None,
    moving: Annotated[list[str] | None, _MOVING] = None,
    without: Annotated[list[str] | None, _WITHOUT] = None,
    plant: Annotated[str | None, _PLANT] = None,
    order: Annotated[Literal["together", "yaw-first"] | None, _ORDER] = None,
    heading: Annotated[Literal["atan", "atan2"] | None, _HEADING] = None,
    gate: Annotated[str | None, _GATE] = None,
    integrators: Annotated[Literal["gate", "start"] | None, _INTEGRATORS] = None,
    sway: Annotated[Literal["actuated", "unactuated"] | None, _SWAY] = None,
    current: Annotated[str | None, _CURRENT] = None,
    push: Annotated[list[str] | None, _PUSH] = None,
    noise: Annotated[list[str] | None, _NOISE] = None,
    seed: Annotated[int, _SEED] = 0,
    continuous: Annotated[bool, _CONTINUOUS] = False,
    log: Annotated[float | None, _LOG] = None,
    out: Annotated[Path | None, _OUT] = None,
    figures: Annotated[Path | None, _FIGURES] = None,
    json: Annotated[Path | None, _JSON] = None,
    effects: EffectsOption = None,
) -> int:
    from undertow.cli._simulation import check_outputs, choices_of, scenario_of, show, simulated, write

    check_outputs(gains, out, figures, json, [vehicle, *gains, *([plant] if plant else []), *(effects or [])])
    scenario = scenario_of(to, start, duration, dt, moving, continuous, noise, seed, push, log)
    choices = choices_of(order, heading, integrators, gate, sway, current)
    records = simulated(vehicle, plant, gains, scenario, choices, without or [], effects or [])
    show([record.result for record in records])
    write(records, out, figures, json)
    return int(any(record.result.diverged is not None for record in records))
