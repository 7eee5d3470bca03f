"""Linearise a vehicle at a steady motion: poles, zeros, margins, what can be moved and seen, pictures.

The steady motion (trim) is found first: what is not stated with --at is found, with as little drift, tilt
and command as can be. Without --at the vehicle hovers, with --current in moving water. Values are in SI, or
have a unit: --at "psi=30 deg".

    undertow linearize mini-auv --at u=0.5 --plot bode --out bode.png

    undertow linearize mini-auv --at u=0.5 --at r=0.1

    undertow linearize bluerov2 --current 0.3,0.1

With --gains the poles are those of the closed loop, and the margins those of each force with the others
closed. Where forward and backward motion have parameters of their own and the vehicle is at rest, --direction
says which to take.

    undertow linearize mini-auv --gains paper-pid --direction u=-1 --plot root-locus --out locus.png

--family 200 draws vehicles from the standard deviations of the vehicle file and the covariance of its last
fit, adds the corners, and says how many are unstable; pictures show them all. An unstable trim is pointed
out, and with --require-stable refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.control.linear.report import Analysis, Channel

Plot = Literal["bode", "step", "poles", "root-locus"]
_AT = typer.Option("--at", metavar="NAME=VALUE", help="Velocity, attitude, depth or command that is held.")
_FREE = typer.Option("--free", metavar="NAME", help="r: may turn; w: may rise or sink; z: depth is found.")
_CURRENT = typer.Option("--current", metavar="NORTH,EAST", help="Velocity of the water over ground, m/s.")
_DIRECTION = typer.Option(
    "--direction",
    metavar="NAME=1|-1",
    help="Whose parameters hold where the vehicle is at rest.",
    show_default="1",
)
_GAINS = typer.Option("--gains", metavar="GAINS", help="Gain file, or name of a bundled one: closed loop.")
_INPUT = typer.Option("--input", metavar="NAME", help="Command, force (surge ...) or, with gains, set-point.")
_OUTPUT = typer.Option("--output", metavar="NAME", help="Reported pose or velocity.")
_SENSORS = typer.Option(
    "--sensors", metavar="NAME,NAME", help="What is measured, for observability.", show_default="all"
)
_FAMILY = typer.Option(
    "--family", metavar="N", help="Draw N vehicles as uncertain as this one.", min=1, max=10_000
)
_PADE = typer.Option("--pade", metavar="ORDER", help="Approximate dead time to this order.", min=0, max=8)
_STABLE = typer.Option("--require-stable", help="Refuse a trim, or a closed loop, that is unstable.")
_OUT = typer.Option("--out", metavar="FILE.png", help="Where to write the picture.")
_JSON = typer.Option("--json", help="Print everything as JSON.")


def linearize(
    vehicle: VehicleArgument,
    at: Annotated[list[str] | None, _AT] = None,
    free: Annotated[list[str] | None, _FREE] = None,
    current: Annotated[str | None, _CURRENT] = None,
    direction: Annotated[list[str] | None, _DIRECTION] = None,
    gains: Annotated[str | None, _GAINS] = None,
    input: Annotated[str | None, _INPUT] = None,
    output: Annotated[str | None, _OUTPUT] = None,
    sensors: Annotated[str | None, _SENSORS] = None,
    family: Annotated[int | None, _FAMILY] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of the draws.", min=0)] = 0,
    pade: Annotated[int, _PADE] = 0,
    require_stable: Annotated[bool, _STABLE] = False,
    plot: Annotated[Plot | None, typer.Option("--plot", help="Draw a picture.")] = None,
    out: Annotated[Path | None, _OUT] = None,
    json: Annotated[bool, _JSON] = False,
    effects: EffectsOption = None,
) -> None:
    from undertow.cli._linear import Wish, analysed, check_picture, refuse_unstable, show
    from undertow.cli._progress import progress
    from undertow.cli._show import print_json
    from undertow.control.linear.failures import told

    check_picture(plot, out, vehicle, gains)
    wish = Wish(vehicle, at or [], free or [], current, direction or [], gains, sensors, effects or [])
    with progress("linearising") as tell, told():
        found = analysed(wish, family, seed, pade, tell)
        channels = found.chosen(input, output)
        content = found.content(channels)  # all of it, before the first line is printed
        drawn = _drawn(plot, found, channels) if plot else None
    if require_stable:
        refuse_unstable(found)
    if json:
        print_json(content)
    else:
        show(found, channels)
    if drawn and out:
        from undertow.identification.report.style import save_png

        save_png(drawn, out)
        typer.echo(f"wrote {out}", err=json)


def _drawn(plot: str, found: Analysis, channels: Sequence[Channel]) -> Figure:
    from undertow.cli._linear_pictures import picture

    return picture(plot, found, channels)
