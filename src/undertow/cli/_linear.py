"""The linear analysis of a vehicle from the words of a command line, and how it is printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from undertow.cli._progress import Report
from undertow.cli._show import console, section, table, text
from undertow.control.gains import GainSet, load_gains
from undertow.control.linear.analysis import Margins, Mode, Reach
from undertow.control.linear.family import Family, family
from undertow.control.linear.numeric import in_current
from undertow.control.linear.report import Analysis, Channel
from undertow.control.linear.trim import Trim, find_trim
from undertow.errors import UndertowError
from undertow.files import check_writable
from undertow.model.loading import load_vehicle, resolve_vehicle
from undertow.model.symbols import POSE, VELOCITY, VELOCITY_UNITS
from undertow.model.units import to_si
from undertow.model.vehicle import Vehicle

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
        ("as stated", _STABLE[stated.stable]),
        ("draws", f"{len(draws)}, of which {len(unstable)} are unstable"),
        ("redrawn", f"{found.refused} that no vehicle can have"),
        ("corners", f"{len(corners)}, of which {len([m for m in corners if not m.stable])} are unstable"),
    ]
    rows += [(f"{_STABLE[not stated.stable]} at", name) for name in other]
    return table(("", ""), rows)


_STABLE = {True: "stable", False: "unstable"}
