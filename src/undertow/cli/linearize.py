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
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from matplotlib.figure import Figure

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument
from undertow.control.gains import GainSet, load_gains
from undertow.control.linear.analysis import (
    Line,
    Margins,
    Mode,
    Reach,
    duration,
    frequencies,
    locus,
    response,
    step,
)
from undertow.control.linear.family import Family, family
from undertow.control.linear.numeric import in_current
from undertow.control.linear.report import Analysis, Channel
from undertow.control.linear.trim import Trim, find_trim
from undertow.errors import UndertowError
from undertow.files import check_writable
from undertow.identification.figures import AFTER, BEFORE, FAINT, FLOOR, INK, figure, look, plain, unit_text
from undertow.model.loading import load_vehicle, resolve_vehicle
from undertow.model.symbols import POSE, VELOCITY, VELOCITY_UNITS
from undertow.model.units import to_si
from undertow.model.vehicle import Vehicle

from ._terminal import Report, console, section, table, text

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
    from undertow.control.linear.numeric import as_input_error

    from ._terminal import print_json, progress

    check_picture(plot, out, vehicle, gains)
    wish = Wish(vehicle, at or [], free or [], current, direction or [], gains, sensors, effects or [])
    with progress("linearising") as tell, as_input_error():
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
        from undertow.identification.figures import save_png

        save_png(drawn, out)
        typer.echo(f"wrote {out}", err=json)


def _drawn(plot: str, found: Analysis, channels: Sequence[Channel]) -> Figure:

    return picture(plot, found, channels)


_UNITS = dict(zip((*POSE, *VELOCITY), (*("m",) * 3, *("rad",) * 3, *VELOCITY_UNITS), strict=True))


@dataclass(frozen=True)
class Wish:
    """What a command line asks of a trim.

    Attributes
    ----------
    vehicle : str
        Vehicle file, or name of a bundled one.
    at, free : list of str
        "u=0.5" ..., and names that are let go.
    current : str or None
        "0.3,0.1", m/s to the north and to the east.
    direction : list of str
        "u=-1" ...
    gains : str or None
        Gain file, or name of a bundled one.
    sensors : str or None
        "x,y,psi".
    effects : list of Path
        Files with effects of the user.
    """

    vehicle: str
    at: list[str]
    free: list[str]
    current: str | None
    direction: list[str]
    gains: str | None = None
    sensors: str | None = None
    effects: Sequence[Path] = ()

    def model(self) -> Vehicle:
        """The vehicle, in the current that is asked for."""
        vehicle = load_vehicle(self.vehicle, effect_files=self.effects)
        if self.current is None:
            return vehicle
        parts = [si("--current", part, "m/s") for part in self.current.split(",")]
        if len(parts) != 2:
            raise UndertowError(
                f"--current {self.current}: give two velocities, such as 0.3,0.1 (north, east)"
            )
        return in_current(vehicle, *parts)

    def held(self) -> dict[str, float] | None:
        """Values that are held, SI; None for hovering."""
        held = {n: si(f"--at {n}", v, _UNITS.get(n, "command")) for n, v in pairs("--at", self.at)}
        return held or None

    def trim(self, vehicle: Vehicle) -> Trim:
        """The steady motion that is asked for."""
        ways = {n: _way(n, v) for n, v in pairs("--direction", self.direction)}
        return find_trim(vehicle, self.held(), free=_words(self.free), direction=ways)


def pairs(option: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    """Names and values out of "u=0.5" and "x=1,z=2"."""
    parts = [word.partition("=") for word in _words(texts)]
    wrong = [name for name, mark, value in parts if not (mark and name.strip() and value.strip())]
    if wrong:
        raise UndertowError(f"{option} {wrong[0]}: write NAME=VALUE, such as u=0.5")
    names = [name.strip() for name, _, _ in parts]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UndertowError(f"{option} names {twice[0]} twice: name it once")
    return [(name.strip(), value.strip()) for name, _, value in parts]


def _words(texts: Sequence[str]) -> list[str]:
    return [word for t in texts for word in t.split(",")]


def si(option: str, value: str, unit: str) -> float:
    """A value in SI: a plain number, or one with a unit."""
    try:
        return to_si(float(value) if _is_number(value) else value, unit)
    except UndertowError as error:
        raise UndertowError(f"{option}: {error}") from error


def _is_number(value: str) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _way(name: str, value: str) -> int:
    if value not in ("1", "+1", "-1"):
        raise UndertowError(f"--direction {name}={value}: write 1 (forward) or -1 (backward)")
    return int(value)


def check_picture(plot: str | None, out: Path | None, *inputs: str | None) -> None:
    """Refuse a picture without a place, a place without a picture, or a name that is none of a picture."""
    if plot and out is None:
        raise UndertowError(f"--plot {plot} has nowhere to go: add --out FILE.png")
    if out and not plot:
        raise UndertowError("--out has no picture to write: add --plot bode, step, poles or root-locus")
    check_writable(out, inputs=[i for i in inputs if i])
    if out and out.suffix.lower() != ".png":
        raise UndertowError(f"--out {out}: pictures are written as PNG; name it {out.with_suffix('.png')}")


def analysed(wish: Wish, size: int | None, seed: int, pade: int, tell: Report) -> Analysis:
    """The analysis that is asked for."""
    vehicle = wish.model()
    gains: GainSet | None = load_gains(wish.gains, vehicle) if wish.gains else None
    sensors = _words([wish.sensors]) if wish.sensors else []
    tell(0.1, "finding the trim")
    found = Analysis(vehicle, wish.trim(vehicle), gains, pade, sensors)
    if size:
        tell(0.3, "drawing vehicles")
        path = resolve_vehicle(wish.vehicle)
        found.family = family(vehicle, found.trim, size, gains=gains, source=path, seed=seed)
    return found


def refuse_unstable(found: Analysis) -> None:
    """Refuse what grows."""
    if found.growing:
        mode = found.growing[0]
        remedy = "change the gains" if found.gains else "close the loop with --gains"
        what = f"the loop with '{found.gains.name}'" if found.gains else "this steady motion"
        raise UndertowError(
            f"{what} of '{found.vehicle.name}' is unstable: a mode in {', '.join(mode.states)} grows with "
            f"{mode.pole.real:.4g} 1/s; {remedy}"
        )


# --- printing -----------------------------------------------------------------------------------
def show(found: Analysis, channels: Sequence[Channel]) -> None:
    """Print everything."""
    out = console()
    trim = found.trim
    section(f"Steady motion of {found.vehicle.name}", _trim(found))
    for remark in trim.remarks:
        out.print(text(f"  {remark}", "yellow"), soft_wrap=True)
    title = f"Poles of the loop with {found.gains.name}" if found.gains else "Poles"
    show_modes(title, found.modes)
    for line in _growth(found):
        out.print(text(f"  {line}", "yellow"), soft_wrap=True)
    section("Zeros", _zeros(channels))
    section(_MARGINS[bool(found.gains)], _margins(found.margins(channels)))
    section("What can be moved and seen")
    for line in [*_reached(found.controllability, *_MOVED), *_reached(found.observability, *_SEEN)]:
        out.print(text(f"  {line}"), soft_wrap=True)
    if found.family:
        section(f"Family from {found.family.spread.source}", _family(found.family))


_MARGINS = {
    True: "Margins of the loop of each force, the others closed",
    False: "Margins if closed with a gain of one (SI)",
}
_MOVED = ("commands move", "no command moves", "commands move only together")
_SEEN = ("sensors show", "no sensor shows", "sensors show only together")


def _trim(found: Analysis) -> object:
    trim, units = found.trim, found.units
    rows = [(n, f"{v:.6g}", units[n]) for n, v in trim.states.items() if n not in ("x", "y")]
    rows += [(n, f"{v:.6g}", units[n]) for n, v in trim.commands.items()]
    return table(("", "value", "unit"), rows)


def show_modes(title: str, modes: Sequence[Mode]) -> None:
    """Print poles."""
    rows = [
        (
            shown(m.pole),
            f"{m.frequency:.5g}",
            f"{m.damping:.6f}" if m.pole else "",
            f"{m.time_constant:.5g}" if isfinite(m.time_constant) else "",
            ", ".join(m.states) + ("" if m.stable else ": grows"),
        )
        for m in modes
    ]
    head = ("pole, rad/s", "omega_n, rad/s", "damping", "time constant, s", "in")
    section(title, table(head, rows))


def shown(value: complex) -> str:
    """A pole or zero; of a pair both."""
    if not value.imag:
        return f"{value.real:.6g}"
    return f"{value.real:.6f} ± {abs(value.imag):.6f}i"


def _growth(found: Analysis) -> list[str]:
    if not found.growing:
        return []
    names = "; ".join(", ".join(m.states) for m in found.growing)
    what = "the closed loop" if found.gains else "this steady motion"
    return [f"{what} is unstable in {names}: a small deviation grows"]


def _zeros(channels: Sequence[Channel]) -> object:
    rows = [(c.name, ", ".join(shown(z) for z in _once(c.zeros)) or "none") for c in channels]
    return table(("channel", "zeros, rad/s"), rows)


def _once(values: Sequence[complex]) -> list[complex]:
    return [v for v in values if v.imag >= 0]


def _margins(margins: dict[str, Margins]) -> object:
    rows = [
        (
            name,
            "yes" if m.stable else "no",
            _number(m.gain, "{:.4g}"),
            _number(m.phase, "{:.2f}"),
            _number(m.delay, "{:.4g}"),
            f"{m.distance:.4g}",
            _number(m.crossover, "{:.4g}", "none"),
        )
        for name, m in margins.items()
    ]
    head = ("loop", "stable", "gain", "phase, deg", "delay, s", "distance", "crossover, rad/s")
    return table(head, rows)


def _number(value: float, form: str, otherwise: str = "any") -> str:
    return form.format(value) if isfinite(value) else otherwise


def _reached(reach: Reach, does: str, does_not: str, mixed: str) -> list[str]:
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
        ("as stated", _LINEAR_STABLE[stated.stable]),
        ("draws", f"{len(draws)}, of which {len(unstable)} are unstable"),
        ("redrawn", f"{found.refused} that no vehicle can have"),
        ("corners", f"{len(corners)}, of which {len([m for m in corners if not m.stable])} are unstable"),
    ]
    rows += [(f"{_LINEAR_STABLE[not stated.stable]} at", name) for name in other]
    return table(("", ""), rows)


_LINEAR_STABLE = {True: "stable", False: "unstable"}


_SPREAD = 100.0
_COLOURS = (AFTER, BEFORE, FLOOR, "#cc79a7", "#e69f00", "#56b4e9")


def picture(kind: str, found: Analysis, channels: Sequence[Channel]) -> Figure:
    """A picture of one kind.

    Raises
    ------
    UndertowError
        If there is nothing to draw, as for a channel that connects nothing.
    """
    draw = {"bode": _bode, "step": _steps, "poles": _poles, "root-locus": _loci}[kind]
    alive = [c for c in channels if c.system.nstates]
    if not channels and kind != "poles":
        raise UndertowError(f"'{found.vehicle.name}' has no thruster, so only --plot poles: state a thruster")
    if not alive and kind != "poles":
        raise UndertowError(f"{channels[0].name} is not connected: choose another --input or --output")
    with look():
        return draw(found, alive)


def _title(found: Analysis, what: str) -> str:
    values = {**found.trim.states, **found.trim.commands}
    held = [f"{n} = {values[n]:.4g}" for n in found.trim.wanted.given if values[n]]
    law = f", {found.gains.name}" if found.gains else ""
    return plain(f"{found.vehicle.name}{law} ({', '.join(held) or 'hovering'}): {what}", 110)


# --- Bode -----------------------------------------------------------------------------------------
def _bode(found: Analysis, channels: Sequence[Channel]) -> Figure:
    drawn, what, unit = _opened(found, channels)
    omega = frequencies([system for _, system in drawn])
    shown, axes = figure(6.0, 2, sharex=True)
    (size,), (angle,) = axes
    for colour, (name, system) in zip(_cycle(len(drawn)), drawn, strict=True):
        for member in _members(found, name, channels):
            _bode_line(size, angle, response("", member, omega), color=colour, alpha=0.12, linewidth=0.7)
        line = response(name, system, omega)
        _bode_line(size, angle, line, color=colour, label=plain(name))
    size.axhline(0.0, color=FAINT, linewidth=0.8, linestyle=":")
    angle.axhline(-180.0, color=FAINT, linewidth=0.8, linestyle=":")
    size.set_ylabel(f"magnitude [dB re {unit}]" if unit else "magnitude [dB]")
    angle.set(ylabel="phase [deg]", xlabel="frequency [rad/s]", xlim=(omega[0], omega[-1]))
    angle.yaxis.set_major_locator(_multiples(45.0))
    size.set_title(_title(found, what))
    size.legend()
    _grids(axes)
    return shown


def _opened(found: Analysis, channels: Sequence[Channel]) -> tuple[list[tuple[str, Any]], str, str]:
    """Systems by name, what they are, and the unit of their gain if it is one for all."""
    if found.loop and all(c.source in found.loop.references for c in channels):
        forces = dict(zip(found.loop.references, found.loop.forces, strict=True))
        wanted = dict.fromkeys(forces[c.source] for c in channels)
        drawn = [(f, found.loop.cut(f)) for f in wanted]
        return [(n, s) for n, s in drawn if s.nstates], "loop of each force, the others closed", "1"
    units = {_per(found, c) for c in channels}
    named = [(f"{c.name} [{_per(found, c)}]" if len(units) > 1 else c.name, c.system) for c in channels]
    return named, "from input to output", next(iter(units)) if len(units) == 1 else "SI"


def _per(found: Analysis, c: Channel) -> str:
    top, below = found.units[c.output], found.units[c.source]
    return unit_text(
        "1" if top == below else f"({top})/({below})" if " " in below or "/" in top else f"{top}/{below}"
    )


def _bode_line(size: Any, angle: Any, line: Line, **style: Any) -> None:
    magnitude = np.abs(line.y)
    size.semilogx(line.x, 20 * np.log10(np.maximum(magnitude, 1e-300)), **style)
    phase = np.degrees(np.unwrap(np.angle(line.y)))
    # Whole turns are open: the last value is put where a proper system of low order has it.
    angle.semilogx(line.x, phase - 360.0 * np.ceil((phase[-1] - 45.0) / 360.0), **style)


def _multiples(base: float) -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=8, steps=[1, 1.5, 3, 4.5, 9, 10], min_n_ticks=3) if base else None


# --- steps ----------------------------------------------------------------------------------------
def _steps(found: Analysis, channels: Sequence[Channel]) -> Figure:
    seconds = duration([c.system for c in channels])
    shown, axes = figure(1.0 + 2.0 * len(channels), len(channels), sharex=True)
    for axis, colour, c in zip(axes[:, 0], _cycle(len(channels)), channels, strict=True):
        for member in found.members_of(c.source, c.output):
            line = step("", member, seconds)
            axis.plot(line.x, line.y.real, color=colour, alpha=0.15, linewidth=0.7)
        line = step(c.name, c.system, seconds)
        axis.plot(line.x, line.y.real, color=colour)
        if found.loop:
            axis.axhline(1.0, color=FAINT, linewidth=0.8, linestyle=":")
        unit, below = unit_text(found.units[c.output]), unit_text(found.units[c.source])
        axis.set_ylabel(f"{plain(c.output)} [{unit}]")
        axis.set_title(plain(f"{c.output} after a step of 1 {below} in {c.source}", 100))
        axis.set_xlim(0.0, seconds)
    axes[-1, 0].set_xlabel("time [s]")
    shown.suptitle(_title(found, "step responses of the linear system"), x=0.01, ha="left", fontsize=10)
    _grids(axes)
    return shown


# --- poles ----------------------------------------------------------------------------------------
def _poles(found: Analysis, channels: Sequence[Channel]) -> Figure:
    shown, axes = figure(5.6)
    axis = axes[0, 0]
    if found.family:
        poles = np.array([q for m in found.family.members for q in _both(m.modes)])
        axis.plot(poles.real, poles.imag, ".", color=FAINT, markersize=3, alpha=0.5, label="family", zorder=1)
    own = np.array(_both(found.modes))
    axis.plot(own.real, own.imag, "x", color=INK, markersize=8, markeredgewidth=1.6, label="poles", zorder=3)
    for colour, c in zip(_cycle(len(channels)), channels, strict=True):
        if c.zeros:
            at = np.array(c.zeros)
            axis.plot(
                at.real,
                at.imag,
                "o",
                color=colour,
                fillstyle="none",
                markersize=7,
                label=f"zeros, {plain(c.name)}",
            )
    _stretch(axis, own)
    _plane(axis)
    axis.set_title(_title(found, "poles of the loop" if found.loop else "poles"))
    axis.legend()
    _grids(axes)
    return shown


def _both(modes: Sequence[Any]) -> list[complex]:
    """Poles of modes, of pairs both."""
    return [q for m in modes for q in ({m.pole, m.pole.conjugate()})]


def _stretch(axis: Any, poles: Any) -> None:
    """Logarithmic axes, linear around zero, where poles are of very different size."""
    sizes = np.abs(poles[np.abs(poles) > 0])
    if sizes.size and sizes.max() > _SPREAD * sizes.min():
        least = 10.0 ** np.floor(np.log10(float(sizes.min())))
        axis.set_xscale("symlog", linthresh=least)
        axis.set_yscale("symlog", linthresh=least)


def _plane(axis: Any) -> None:
    axis.axvline(0.0, color=INK, linewidth=0.8)
    axis.axhline(0.0, color=FAINT, linewidth=0.6)
    low, high = axis.get_xlim()
    if high > 0:
        axis.axvspan(0.0, high, color=BEFORE, alpha=0.07, linewidth=0)
    axis.set_xlim(low, high)
    scale = ", logarithmic but near zero" if axis.get_xscale() == "symlog" else ""
    axis.set(xlabel=f"real part [1/s]{scale}", ylabel=f"imaginary part [rad/s]{scale}")


# --- root locus -----------------------------------------------------------------------------------
def _loci(found: Analysis, channels: Sequence[Channel]) -> Figure:
    drawn, what, _ = _opened(found, channels[:3])
    shown, axes = figure(1.0 + 3.6 * len(drawn), len(drawn))
    for axis, colour, (name, system) in zip(axes[:, 0], _cycle(len(drawn)), drawn, strict=True):
        _, paths = locus(system)
        axis.plot(paths.real, paths.imag, color=colour, linewidth=1.1)
        begin, end = system.poles(), np.asarray(system.zeros())
        axis.plot(begin.real, begin.imag, "x", color=INK, label="gain 0")
        axis.plot(end.real, end.imag, "o", color=INK, fillstyle="none", label="gain without end")
        now = _closed_poles(system)
        words = "gain 1 (the law as it is)" if found.loop else "gain 1"
        axis.plot(now.real, now.imag, "s", color=BEFORE, markersize=5, label=words)
        _frame(axis, now)
        _plane(axis)
        axis.set_title(plain(name, 90))
        axis.legend()
    shown.suptitle(_title(found, f"root locus, {what}"), x=0.01, ha="left", fontsize=10)
    _grids(axes)
    return shown


def _frame(axis: Any, points: Any) -> None:
    """A window around what matters: branches run away without end."""
    wide = max(1.8 * float(np.max(np.abs(points), initial=0.0)), 1e-3)
    right = max(0.3 * wide, 1.5 * float(np.max(points.real, initial=0.0)))
    axis.set(xlim=(-wide, right), ylim=(-wide, wide))


def _closed_poles(system: Any) -> Any:
    a = system.A - system.B @ system.C / (1 + system.D[0, 0])
    return np.linalg.eigvals(a)


# --- shared ---------------------------------------------------------------------------------------
def _members(found: Analysis, name: str, channels: Sequence[Channel]) -> list[Any]:
    """What stands behind a line of a Bode picture."""
    for c in channels:
        if name.startswith(c.name):
            return found.members_of(c.source, c.output)
    return found.members_of(name, None)


def _cycle(count: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(count)]


def _grids(axes: Any) -> None:
    for axis in axes.ravel():
        axis.grid()
