"""Linearise a vehicle at a steady motion: poles, zeros, margins, controllability, observability, plots.

The steady motion (trim) is found first: --at states part of it, and the rest is chosen with as little drift,
tilt and command as possible. Without --at the vehicle hovers, with --current in moving water. Values are in
SI, or have a unit: --at "psi=30 deg".

    undertow linearize mini-auv --at u=0.5 --plot bode --out bode.png

    undertow linearize mini-auv --at u=0.5 --at r=0.1

    undertow linearize bluerov2 --current 0.3,0.1

With --gains, the poles are those of the closed loop, and the margins those of each force with the others
closed. With --observer, the steady-state Kalman filter is in that loop. If forward and backward motion have
different parameters and the vehicle is at rest, --direction says which to use.

    undertow linearize mini-auv --gains paper-pid --direction u=-1 --plot root-locus --out locus.png

--family 200 draws vehicles from the standard deviations of the vehicle file and the covariance of its last
fit, adds the corners, and counts the unstable ones; plots show them all. An unstable trim is reported;
--require-stable refuses it.

--dt gives the sampled system: commands are held (zero-order hold), the law runs as its C code does, dead
times are whole samples, poles and zeros are in z.

    undertow linearize mini-auv --gains paper-pd --dt 0.1
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.errors import UndertowError

from .._options import (
    CurrentOption,
    EffectsOption,
    JsonOption,
    VehicleArgument,
    current_of,
    in_si,
    names_and_values,
    quantities,
    words,
)
from .._terminal import print_json, progress, say, section, table

if TYPE_CHECKING:
    from undertow.control.linear.analysis import Margins, Mode, Subspace
    from undertow.control.linear.family import Family
    from undertow.control.linear.report import Analysis, Channel
    from undertow.model.vehicle import Vehicle

Plot = Literal["bode", "nyquist", "nichols", "singular-values", "disk-margins", "step", "poles", "root-locus"]
_AT = typer.Option(metavar="NAME=VALUE", help="Velocity, attitude, depth or command to hold fixed.")
_FREE = typer.Option(
    metavar="NAME",
    help="Let it vary: u, v (need not hover), r (may turn), w (may rise or sink), z (depth is found).",
)
DIRECTION = typer.Option(
    "--direction", metavar="NAME=1|-1", help="Direction whose parameters are used at rest.", show_default="1"
)
_GAINS = typer.Option(metavar="GAINS", help="Gain file, or name of a bundled one; closes the loop.")
_OBSERVER = typer.Option(metavar="FILE", help="Observer file; the control law uses its estimate.")
_INPUT = typer.Option(
    metavar="NAME", help="Input: a command, a force (surge ...) or, with --gains, a set-point."
)
_SENSORS = typer.Option(metavar="NAME,NAME", help="Measured channels, for observability.", show_default="all")
_FAMILY = typer.Option(metavar="N", help="Draw N vehicles from the parameter uncertainty.", min=1, max=10_000)
_PADE = typer.Option(metavar="ORDER", help="Approximate dead time to this order.", min=0, max=8)
_DT = typer.Option(metavar="TIME", help="Sampling interval for the sampled system, s; commands are held.")
_TOGETHER = typer.Option("--together", help="Disk margin of all forces together (extra slycot).")
_STABLE = typer.Option("--require-stable", help="Refuse an unstable trim or closed loop.")


def linearize(
    vehicle: VehicleArgument,
    at: Annotated[list[str] | None, _AT] = None,
    free: Annotated[list[str] | None, _FREE] = None,
    current: CurrentOption = None,
    direction: Annotated[list[str] | None, DIRECTION] = None,
    gains: Annotated[str | None, _GAINS] = None,
    observer: Annotated[Path | None, _OBSERVER] = None,
    input: Annotated[str | None, _INPUT] = None,
    output: Annotated[
        str | None, typer.Option(metavar="NAME", help="Output: a reported pose or velocity.")
    ] = None,
    sensors: Annotated[str | None, _SENSORS] = None,
    family: Annotated[int | None, _FAMILY] = None,
    seed: Annotated[int, typer.Option(help="Seed of the draws.", min=0)] = 0,
    pade: Annotated[int, _PADE] = 0,
    dt: Annotated[str | None, _DT] = None,
    together: Annotated[bool, _TOGETHER] = False,
    require_stable: Annotated[bool, _STABLE] = False,
    plot: Annotated[Plot | None, typer.Option(help="Draw a plot.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Where to write the plot.")] = None,
    json: JsonOption = False,
    effects: EffectsOption = None,
) -> None:
    from undertow.control.linear.numeric import as_input_error
    from undertow.control.linear.report import analyse

    _check_picture(plot, out, vehicle, gains)
    with progress("linearising") as report, as_input_error():
        found = analyse(
            _in_current(vehicle, current, effects or []),
            held(at or []),
            free=words(free or []),
            direction=directions(direction or []),
            gains=gains,
            observer=observer,
            pade=pade,
            dt=_sampling_time(dt),
            together=together,
            sensors=words([sensors]) if sensors else [],
            family_of=family or 0,
            source=vehicle,
            seed=seed,
            progress=report,
        )
        channels = found.select_channels(input, output)
        content = found.content(channels)  # all of it, before the first line is printed
        if plot:
            from undertow.control.linear.pictures import picture

            drawn = picture(plot, found, channels)
    if require_stable:
        found.require_stable()
    if json:
        print_json(content)
    else:
        show(found, channels)
    if plot and out:
        from undertow.figures import save_png

        save_png(drawn, out)
        typer.echo(f"wrote {out}", err=json)


def _sampling_time(text: str | None) -> float:
    """The sampling time, s; 0 for continuous."""
    if text is None:
        return 0.0
    dt = in_si("--dt", text, "s")
    if dt <= 0:
        raise UndertowError(f"--dt {text} is not a sampling time: give one above zero, such as 0.1")
    return dt


def _in_current(vehicle: str, current: str | None, effects: Sequence[Path]) -> Vehicle:
    """The vehicle, in the current that is asked for."""
    from undertow.control.plant import in_current
    from undertow.model.loading import load_vehicle

    model = load_vehicle(vehicle, effect_files=effects)
    if current is None:
        return model
    return in_current(model, *current_of(current))


def held(at: Sequence[str]) -> dict[str, float] | None:
    """Values of --at that are held, SI; None for hovering."""
    from undertow.model.symbols import MOTION_UNITS

    return quantities("--at", at, MOTION_UNITS, "command") or None


def directions(texts: Sequence[str]) -> dict[str, int]:
    """Values of --direction, 1 or -1 by name."""
    pairs = names_and_values("--direction", texts, "u=0.5")
    for name, value in pairs:
        if value not in ("1", "+1", "-1"):
            raise UndertowError(f"--direction {name}={value}: write 1 (forward) or -1 (backward)")
    return {name: int(value) for name, value in pairs}


def _check_picture(plot: str | None, out: Path | None, *inputs: str | None) -> None:
    """Refuse a picture without a place, a place without a picture, or a file that is not PNG."""
    from undertow.files import check_writable

    if plot and out is None:
        raise UndertowError(f"--plot {plot} needs a file: add --out FILE.png")
    if out and not plot:
        raise UndertowError("--out needs a picture: add --plot bode, nyquist, step, poles ...")
    check_writable(out, inputs=[i for i in inputs if i])
    if out and out.suffix.lower() != ".png":
        raise UndertowError(f"--out {out}: pictures are written as PNG; name it {out.with_suffix('.png')}")


def show(found: Analysis, channels: Sequence[Channel]) -> None:
    """Print everything."""
    trim, units = found.trim, found.units
    rows = [(n, f"{v:.6g}", units[n]) for n, v in trim.states.items() if n not in ("x", "y")]
    rows += [(n, f"{v:.6g}", units[n]) for n, v in trim.commands.items()]
    section(f"Steady motion of {found.vehicle.name}", table(("", "value", "unit"), rows))
    for remark in found.trim.remarks:
        say(f"  {remark}", "yellow")
    title = f"Poles of the loop with {found.gains.name}" if found.gains else "Poles"
    title += f", sampled every {found.dt:g} s" if found.dt else ""
    show_modes(title, found.modes)
    if found.growing:
        names = "; ".join(", ".join(m.states) for m in found.growing)
        what = "the closed loop" if found.gains else "this steady motion"
        say(f"  {what} is unstable in {names}: a small deviation grows", "yellow")
    section("Zeros", _zeros(channels, "z" if found.dt else "rad/s"))
    section(_MARGINS[bool(found.gains)], _margins(found.margins(channels)))
    if found.multiloop_disk is not None:
        say(f"  all forces at once: disk {found.multiloop_disk:.4g}")
    section("Controllability and observability")
    for line in [*_subspace(found.controllability, *_MOVED), *_subspace(found.observability, *_SEEN)]:
        say(f"  {line}")
    if found.family:
        section(f"Family from {found.family.spread.source}", _family(found.family))


_MARGINS = {
    True: "Margins of the loop of each force, the others closed",
    False: "Margins if closed with a gain of one (SI)",
}
_MOVED = ("commands move", "no command moves", "commands are linearly dependent")
_SEEN = ("sensors show", "no sensor shows", "sensors are linearly dependent")


def show_modes(title: str, modes: Sequence[Mode]) -> None:
    """Print poles."""
    rows = [
        (
            shown(m.pole),
            *([f"{m.magnitude:.6f}"] if m.dt else []),
            f"{m.frequency:.5g}",
            f"{m.damping:.6f}" if m.rate else "",
            f"{m.time_constant:.5g}" if isfinite(m.time_constant) else "",
            ", ".join(m.states) + ("" if m.stable else ": grows"),
        )
        for m in modes
    ]
    poles = ("pole, z", "magnitude") if modes and modes[0].dt else ("pole, rad/s",)
    head = (*poles, "omega_n, rad/s", "damping", "time constant, s", "in")
    section(title, table(head, rows))


def shown(value: complex) -> str:
    """A pole or zero; of a pair both."""
    if not value.imag:
        return f"{value.real:.6g}"
    return f"{value.real:.6f} ± {abs(value.imag):.6f}i"


def _zeros(channels: Sequence[Channel], unit: str) -> object:
    # Of conjugate zeros one stands for both.
    rows = [(c.name, ", ".join(shown(z) for z in c.zeros if z.imag >= 0) or "none") for c in channels]
    return table(("channel", f"zeros, {unit}"), rows)


def _margins(margins: dict[str, Margins]) -> object:
    rows = [
        (
            name,
            "yes" if m.stable else "no",
            _number(m.gain, "{:.4g}"),
            _number(m.phase, "{:.2f}"),
            _number(m.delay, "{:.4g}"),
            f"{m.distance:.4g}",
            f"{m.disk:.4g}",
            _number(m.crossover, "{:.4g}", "none"),
        )
        for name, m in margins.items()
    ]
    head = ("loop", "stable", "gain", "phase, deg", "delay, s", "distance", "disk", "crossover, rad/s")
    return table(head, rows)


def _number(value: float, form: str, otherwise: str = "any") -> str:
    return form.format(value) if isfinite(value) else otherwise


def _subspace(reach: Subspace, does: str, does_not: str, mixed: str) -> list[str]:
    lines = [f"{does} {reach.rank} of {reach.of} state directions"]
    if reach.missing:
        lines.append(f"{does_not} {', '.join(reach.missing)}")
    if reach.mixed:
        lines.append(f"{mixed}: {', '.join(reach.mixed)}")
    largest, least = reach.singular[0], reach.singular[-1]
    span = f"{largest:.3g} down to {max(least, 0):.3g}"
    return [*lines, f"  Gramian over {reach.horizon:.3g} s: singular values from {span} (SI)"]


def _family(found: Family) -> object:
    draws = [m for m in found.members if m.name.startswith("draw ")]
    unstable = [m for m in draws if not m.stable]
    stated, *corners = [m for m in found.members if m not in draws]
    other = [m.name for m in corners if m.stable != stated.stable]
    rows = [
        ("as stated", _STABLE_WORDS[stated.stable]),
        ("draws", f"{len(draws)}, of which {len(unstable)} are unstable"),
        ("redrawn", f"{found.refused} impossible ones redrawn"),
        ("corners", f"{len(corners)}, of which {len([m for m in corners if not m.stable])} are unstable"),
    ]
    rows += [(f"{_STABLE_WORDS[not stated.stable]} at", name) for name in other]
    return table(("", ""), rows)


_STABLE_WORDS = {True: "stable", False: "unstable"}
