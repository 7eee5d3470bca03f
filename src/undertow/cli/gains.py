"""Check the gains of a control law against every condition for stability, on the model of the vehicle.

Conditions come in three forms: as the mini-AUV paper prints them, with units that fit, and derived anew from
the model; as matrices and channel by channel; for the forward and the backward set of parameters; over all
headings and attitudes with a proof; over the uncertainty that the vehicle file states. Every linearised
channel is judged by Routh-Hurwitz, the Lyapunov function is compared with the model.

    undertow gains mini-auv paper-pid
    undertow gains rov.toml my-gains.toml --form derived --repair lyapunov

The first line shows why the published PID gains do not work: their surge loop is unstable. In a pipeline,
--form derived leaves the printed conditions out, which ask for far more than stability needs, and --json
prints everything for a program. --repair proposes the smallest change of the gains after which the literal
(printed) conditions, the lyapunov (derived) conditions or only routh (linear stability) hold.

Then comes what makes a yes: the region from which every motion comes to rest with no command beyond the
limit of its thruster, in errors and speeds; what becomes of axes that nothing pushes; and, where effects,
sensors or such axes are outside the conditions, the whole loop, linearised at all headings and simulated.

The exit code is 0 where all conditions hold, a region is certified (or the axes left alone come to rest) and
the whole loop is stable; 1 where something fails, is not proved or could not be judged; 2 for a mistake in
the input.
"""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument

_GAINS = typer.Argument(
    metavar="GAINS", help="Gain file (TOML), or a bundled set: paper-pd, paper-pid, paper-smc."
)
_FORM = typer.Option("--form", help="Check conditions of this form only.", show_default="all")
_IOTA = typer.Option(
    "--iota", metavar="PER_SECOND", help="The constant of the PID conditions.", show_default="searched for"
)
_CONFIDENCE = typer.Option(
    "--confidence", min=0.5, max=0.9999, help="Probability of intervals and ellipsoid of the parameters."
)
_TILT = typer.Option(
    "--tilt", metavar="DEGREES", min=1.0, max=85.0, help="Largest roll and pitch that the check covers."
)
_REPAIR = typer.Option("--repair", help="Propose the smallest change of the gains that satisfies these.")
_JSON = typer.Option("--json", help="Print JSON instead of text.")


def gains(
    vehicle: VehicleArgument,
    gains: Annotated[str, _GAINS],
    form: Annotated[Literal["printed", "units", "derived"] | None, _FORM] = None,
    iota: Annotated[float | None, _IOTA] = None,
    confidence: Annotated[float, _CONFIDENCE] = 0.95,
    tilt: Annotated[float, _TILT] = 60.0,
    repair: Annotated[Literal["literal", "lyapunov", "routh"] | None, _REPAIR] = None,
    json: Annotated[bool, _JSON] = False,
    effects: EffectsOption = None,
) -> int:
    from undertow.cli._gains import judge, show, show_json
    from undertow.cli._progress import progress

    with progress("checking the gains") as tell:
        judged = judge(
            vehicle, gains, [form] if form else [], iota, confidence, tilt, repair, effects or [], tell
        )
    (show_json if json else show)(judged)
    return 0 if judged.report.ok else 1
