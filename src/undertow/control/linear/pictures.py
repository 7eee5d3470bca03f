"""Plots of a linear analysis: frequency responses, step responses, poles and root loci."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from undertow.errors import UndertowError
from undertow.figures import BEFORE, COLOURS, FAINT, INK, figure, look, plain, unit_text
from undertow.typing import Array

from .analysis import (
    Curve,
    disks,
    duration,
    frequencies,
    locus,
    modes,
    multiloop_disks,
    response,
    singular_values,
    step,
)
from .report import Analysis, Channel


@dataclass(frozen=True)
class LinearPictureSettings:
    """How poles and curves are drawn."""

    # Ratio of the largest to the smallest pole from which axes are logarithmic.
    logarithmic_ratio: float = 100.0
    # Damping ratio of a pole below which frequencies around it are added.
    light_damping: float = 0.3
    # Relative difference of curves that look like one, in dB, and of those of disks: the width of a line.
    same_response: float = 0.12
    same_disk: float = 0.012


SETTINGS = LinearPictureSettings()
# Line styles of the first, second and further one of curves that look like one.
_DASHES: tuple[Any, ...] = ("-", (0, (4, 4)), (0, (2, 6)))


def picture(kind: str, found: Analysis, channels: Sequence[Channel]) -> Figure:
    """A picture of a kind that `undertow linearize --plot` has."""
    draw = {
        **{"bode": _bode, "nyquist": _nyquist, "nichols": _nichols, "singular-values": _singular_values},
        **{"disk-margins": _disk_margins, "step": _steps, "poles": _poles, "root-locus": _loci},
    }[kind]
    connected = [c for c in channels if c.system.nstates]
    if not channels and kind != "poles":
        raise UndertowError(
            f"'{found.vehicle.name}' has no thruster, so only --plot poles works: add a thruster"
        )
    if not connected and kind != "poles":
        raise UndertowError(f"{channels[0].name} is not connected: choose another --input or --output")
    with look():
        return draw(found, connected)


def _title(found: Analysis, what: str) -> str:
    values = {**found.trim.states, **found.trim.commands}
    held = [f"{n} = {values[n]:.4g}" for n in found.trim.request.stated if values[n]]
    what += f", sampled every {found.dt:g} s" if found.dt else ""
    law = f", {found.gains.name}" if found.gains else ""
    return plain(f"{found.vehicle.name}{law} ({', '.join(held) or 'hovering'}): {what}", 110)


# --- Bode -----------------------------------------------------------------------------------------
def _bode(found: Analysis, channels: Sequence[Channel]) -> Figure:
    shown, axes = figure(6.0, 2, sharex=True)
    (size,), (angle,) = axes

    def draw(line: Curve, **style: Any) -> None:
        size.semilogx(line.x, decibels(line.y), **style)
        angle.semilogx(line.x, _phase(line), **style)

    omega, what, unit = _draw_responses(found, channels, draw)
    size.axhline(0.0, color=FAINT, linewidth=0.8, linestyle=":")
    angle.axhline(-180.0, color=FAINT, linewidth=0.8, linestyle=":")
    size.set_ylabel(f"magnitude [dB re {unit}]" if unit else "magnitude [dB]")
    angle.set(ylabel="phase [deg]", xlabel="frequency [rad/s]", xlim=(omega[0], omega[-1]))
    angle.yaxis.set_major_locator(_degrees())
    return _titled(shown, axes, _title(found, what))


def _systems(found: Analysis, channels: Sequence[Channel]) -> tuple[list[tuple[str, Any]], str, str]:
    """Systems by name, what they are, and the unit of their gain if it is one for all."""
    if found.loop and all(c.source in found.loop.references for c in channels):
        forces = dict(zip(found.loop.references, found.loop.forces, strict=True))
        wanted = dict.fromkeys(forces[c.source] for c in channels)
        drawn = [(f, found.loop.single_loop(f)) for f in wanted]
        return [(n, s) for n, s in drawn if s.nstates], "loop of each force, the others closed", "1"
    units = {_gain_unit(found, c) for c in channels}
    named = [(f"{c.name} [{_gain_unit(found, c)}]" if len(units) > 1 else c.name, c.system) for c in channels]
    return named, "from input to output", next(iter(units)) if len(units) == 1 else "SI"


def _gain_unit(found: Analysis, c: Channel) -> str:
    top, below = found.units[c.output], found.units[c.source]
    return unit_text(
        "1" if top == below else f"({top})/({below})" if " " in below or "/" in top else f"{top}/{below}"
    )


def _draw_responses(
    found: Analysis, channels: Sequence[Channel], draw: Callable[..., None]
) -> tuple[Array, str, str]:
    """Let `draw` draw every response over its family; the frequencies, what they are, and the unit."""
    systems, what, unit = _systems(found, channels)
    omega = _with_resonances([system for _, system in systems])
    lines = [response(name, system, omega) for name, system in systems]
    styles = _styles([line.y for line in lines])
    for colour, style, line in zip(_colours(len(systems)), styles, lines, strict=True):
        for member in _members(found, line.name, channels):
            draw(response("", member, omega), color=colour, alpha=0.12, linewidth=0.7)
        draw(line, color=colour, linestyle=style, label=plain(line.name))
    return omega, what, unit


def _with_resonances(systems: Sequence[Any]) -> Array:
    """Frequencies, rad/s, closer together around poles of little damping, where a curve turns quickly."""
    omega = frequencies(list(systems))
    rates = np.array([m.rate for s in systems for m in modes(s) if np.isfinite(m.rate)])
    sharp = rates[np.abs(rates.real) < SETTINGS.light_damping * np.abs(rates)]
    near = (np.abs(sharp.imag)[:, None] + np.abs(sharp.real)[:, None] * np.linspace(-6, 6, 61)).ravel()
    return np.union1d(omega, near[(near > omega[0]) & (near < omega[-1])])


def _styles(curves: Sequence[Any], tolerance: float = SETTINGS.same_response) -> list[Any]:
    """Line styles: dashes for a curve that lies on others everywhere, so that these are seen between them."""
    with np.errstate(divide="ignore", invalid="ignore"):
        covered = [
            sum(bool(np.all(np.abs(np.log(one / own)) <= tolerance)) for one in curves[:i])
            for i, own in enumerate(curves)
        ]
    return [_DASHES[min(count, len(_DASHES) - 1)] for count in covered]


def decibels(values: Any) -> Any:
    """Magnitudes in dB."""
    return 20 * np.log10(np.maximum(np.abs(values), 1e-300))


def _phase(line: Curve) -> Any:
    phase = np.degrees(np.unwrap(np.angle(line.y)))
    # Whole turns are open: the last value is put where a proper system of low order has it.
    return phase - 360.0 * np.ceil((phase[-1] - 45.0) / 360.0)


# --- Nyquist, Nichols, singular values --------------------------------------------------------------
def _nyquist(found: Analysis, channels: Sequence[Channel]) -> Figure:
    shown, axes = figure(5.6)
    axis = axes[0, 0]

    def draw(line: Curve, **style: Any) -> None:
        axis.plot(line.y.real, line.y.imag, **style)
        if line.name:  # of the model itself the mirror image, too
            axis.plot(line.y.real, -line.y.imag, color=style["color"], linestyle=":", linewidth=0.9)

    _, what, unit = _draw_responses(found, channels, draw)
    turn = np.linspace(0.0, 2 * np.pi, 200)
    axis.plot([], [], color=INK, linewidth=0.9, linestyle=":", label="negative frequencies")
    axis.plot(np.cos(turn), np.sin(turn), color=FAINT, linewidth=0.8, label="unit circle")
    axis.plot(-1.0, 0.0, "+", color=INK, markersize=11, markeredgewidth=1.8, label="-1")
    # A loop with an integral comes from infinity: what decides is near -1.
    axis.set(xlim=(-3.0, 1.5), ylim=(-2.0, 2.0))
    axis.set_aspect("equal", adjustable="datalim")
    words = f" [{unit}]" if unit else ""
    axis.set(xlabel=f"real part{words}", ylabel=f"imaginary part{words}")
    return _titled(shown, axes, _title(found, f"Nyquist, {what}"))


def _nichols(found: Analysis, channels: Sequence[Channel]) -> Figure:
    shown, axes = figure(5.6)
    axis = axes[0, 0]

    def draw(line: Curve, **style: Any) -> None:
        axis.plot(_phase(line), decibels(line.y), **style)

    _, what, unit = _draw_responses(found, channels, draw)
    axis.plot(-180.0, 0.0, "+", color=INK, markersize=11, markeredgewidth=1.8, label="-180 deg, 0 dB")
    axis.set(xlabel="phase [deg]", ylabel=f"magnitude [dB re {unit}]" if unit else "magnitude [dB]")
    axis.xaxis.set_major_locator(_degrees())
    return _titled(shown, axes, _title(found, f"Nichols, {what}"))


def _singular_values(found: Analysis, channels: Sequence[Channel]) -> Figure:
    """Of all commands to all velocities together, or of all set-points to all coordinates."""
    system = found.combined(channels)
    words = f"{_listed(system.input_labels)} to {_listed(system.output_labels)}"
    omega = _with_resonances([system])
    values = singular_values(system, omega)
    shown, axes = figure(4.6)
    axis = axes[0, 0]
    drawn = zip(_colours(len(values)), _styles(list(values)), values, strict=True)
    for i, (colour, style, row) in enumerate(drawn, start=1):
        axis.semilogx(omega, decibels(row), color=colour, linestyle=style, label=f"singular value {i}")
    axis.axhline(0.0, color=FAINT, linewidth=0.8, linestyle=":")
    axis.set(xlabel="frequency [rad/s]", ylabel="singular value [dB re SI]", xlim=(omega[0], omega[-1]))
    return _titled(shown, axes, _title(found, f"singular values, {words}"))


def _disk_margins(found: Analysis, channels: Sequence[Channel]) -> Figure:
    """Disks at each frequency, the least of which is the margin: of each force and, if asked for, of all."""
    loop = found.loop
    if loop is None:
        raise UndertowError("disk margins are those of a closed loop: state --gains")
    systems = {f: loop.single_loop(f) for f in loop.forces}
    omega = _with_resonances([s for s in systems.values() if s.nstates])
    shown, axes = figure(4.6)
    axis = axes[0, 0]
    curves = [disks(response(force, system, omega).y) for force, system in systems.items()]
    drawn = zip(_colours(len(systems)), _styles(curves, SETTINGS.same_disk), systems, curves, strict=True)
    for colour, style, force, values in drawn:
        m = loop.margins[force]
        words = f"least {m.disk:.2f}" if m.stable else "unstable: no margin"
        axis.semilogx(omega, values, color=colour, linestyle=style, label=plain(f"{force}, {words}"))
    if found.multiloop_disk is not None:
        values = multiloop_disks(loop.actuated_loop, omega)
        axis.semilogx(omega, values, "--", color=INK, label=f"all at once, least {found.multiloop_disk:.2f}")
    axis.set(
        xlabel="frequency [rad/s]", ylabel="size of the disk [1]", xlim=(omega[0], omega[-1]), ylim=(0, None)
    )
    return _titled(shown, axes, _title(found, "disk margins, loop of each force, the others closed"))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) < 4 else f"{names[0]} ... {names[-1]}"


# --- steps ----------------------------------------------------------------------------------------
def _steps(found: Analysis, channels: Sequence[Channel]) -> Figure:
    seconds = duration([c.system for c in channels])
    shown, axes = figure(1.0 + 2.0 * len(channels), len(channels), sharex=True)
    for axis, colour, c in zip(axes[:, 0], _colours(len(channels)), channels, strict=True):
        for member in found.members_of(c.source, c.output):
            line = step("", member, seconds)
            axis.plot(line.x, line.y.real, color=colour, alpha=0.15, linewidth=0.7)
        line = step(c.name, c.system, seconds)
        axis.plot(line.x, line.y.real, color=colour, drawstyle="steps-post" if found.dt else "default")
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
        poles = np.array([q for m in found.family.members for q in _conjugate_poles(m.modes)])
        axis.plot(poles.real, poles.imag, ".", color=FAINT, markersize=3, alpha=0.5, label="family", zorder=1)
    own = np.array(_conjugate_poles(found.modes))
    axis.plot(own.real, own.imag, "x", color=INK, markersize=8, markeredgewidth=1.6, label="poles", zorder=3)
    for colour, c in zip(_colours(len(channels)), channels, strict=True):
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
    if not found.dt:
        # Logarithmic axes, linear around zero, where poles are of very different size.
        sizes = np.abs(own[np.abs(own) > 0])
        if sizes.size and sizes.max() > SETTINGS.logarithmic_ratio * sizes.min():
            least = 10.0 ** np.floor(np.log10(float(sizes.min())))
            axis.set_xscale("symlog", linthresh=least)
            axis.set_yscale("symlog", linthresh=least)
    _stability_limit(axis, found.dt)
    return _titled(shown, axes, _title(found, "poles of the loop" if found.loop else "poles"))


def _conjugate_poles(modes: Sequence[Any]) -> list[complex]:
    """Poles of modes, of pairs both."""
    return [q for m in modes for q in ({m.pole, m.pole.conjugate()})]


def _stability_limit(axis: Any, dt: float = 0.0) -> None:
    """The stability limit: the imaginary axis, or the unit circle of z."""
    if dt:
        turn = np.linspace(0.0, 2 * np.pi, 400)
        axis.plot(np.cos(turn), np.sin(turn), color=INK, linewidth=0.8, zorder=0)
        axis.axhline(0.0, color=FAINT, linewidth=0.6)
        axis.set_aspect("equal", adjustable="datalim")
        axis.set(xlabel=f"real part of z (samples of {dt:g} s)", ylabel="imaginary part of z")
        return
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
    drawn, what, _ = _systems(found, channels[:3])
    shown, axes = figure(1.0 + 3.6 * len(drawn), len(drawn))
    for axis, colour, (name, system) in zip(axes[:, 0], _colours(len(drawn)), drawn, strict=True):
        paths = locus(system)
        axis.plot(paths.real, paths.imag, color=colour, linewidth=1.1)
        begin, end = system.poles(), np.asarray(system.zeros())
        axis.plot(begin.real, begin.imag, "x", color=INK, label="gain 0")
        axis.plot(end.real, end.imag, "o", color=INK, fillstyle="none", label="gain without end")
        now = np.linalg.eigvals(system.A - system.B @ system.C / (1 + system.D[0, 0]))
        words = "gain 1 (the law as it is)" if found.loop else "gain 1"
        axis.plot(now.real, now.imag, "s", color=BEFORE, markersize=5, label=words)
        if found.dt:
            axis.set(xlim=(-1.6, 1.6), ylim=(-1.15, 1.15))
        else:
            # A window around the relevant part: branches go to infinity.
            wide = max(1.8 * float(np.max(np.abs(now), initial=0.0)), 1e-3)
            right = max(0.3 * wide, 1.5 * float(np.max(now.real, initial=0.0)))
            axis.set(xlim=(-wide, right), ylim=(-wide, wide))
        _stability_limit(axis, found.dt)
        axis.set_title(plain(name, 90))
        _legend(axis)
    shown.suptitle(_title(found, f"root locus, {what}"), x=0.01, ha="left", fontsize=10)
    _grids(axes)
    return shown


# --- shared ---------------------------------------------------------------------------------------
def _members(found: Analysis, name: str, channels: Sequence[Channel]) -> list[Any]:
    """What stands behind a line of a Bode picture."""
    for c in channels:
        if name.startswith(c.name):
            return found.members_of(c.source, c.output)
    return found.members_of(name, None)


def _colours(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def _degrees() -> MaxNLocator:
    """Ticks of an axis in degrees, such as every 15, 30, 45 or 90."""
    return MaxNLocator(nbins=8, steps=[1, 1.5, 3, 4.5, 9, 10], min_n_ticks=3)


def _titled(shown: Figure, axes: Any, title: str) -> Figure:
    axes[0, 0].set_title(title)
    _legend(axes[0, 0])
    _grids(axes)
    return shown


def _legend(axis: Any) -> None:
    """On a background of its own, so that no line runs through its words."""
    axis.legend(frameon=True, framealpha=0.9, edgecolor="none", facecolor="white")


def _grids(axes: Any) -> None:
    for axis in axes.ravel():
        axis.grid()
