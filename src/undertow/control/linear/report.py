"""The result of a linear analysis, as plain data, and changes since the last one."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import zip_longest
from math import isfinite
from pathlib import Path
from typing import Any

import control as ct
from pydantic import TypeAdapter

from undertow.control.gains import GainSet, load_gains
from undertow.errors import UndertowError, refuse_unknown
from undertow.files import json_ready
from undertow.model.loading import resolve_vehicle
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.observer.design import Design, load_observer
from undertow.typing import Array, Progress

from .analysis import (
    Margins,
    Mode,
    Subspace,
    channel,
    controllability,
    margins,
    minimal,
    modes,
    observability,
    zeros_of,
)
from .family import SETTINGS as FAMILY
from .family import Family, family
from .numeric import Numeric, reversing
from .systems import LinearLoop, close_loop, forces_of, linearize, named, with_forces
from .trim import Trim, find_trim


@dataclass(frozen=True)
class Channel:
    """One input and one output, and the minimal system between them."""

    source: str
    output: str
    system: ct.StateSpace

    @property
    def name(self) -> str:
        """Both names."""
        return f"{self.source} to {self.output}"

    @cached_property
    def zeros(self) -> list[complex]:
        """Zeros, rad/s."""
        return zeros_of(self.system)


@dataclass
class Analysis:
    """A vehicle at a trim, linear."""

    vehicle: Vehicle
    trim: Trim
    gains: GainSet | None = None  # the law that closes the loop
    pade: int = 0  # order of the approximation of a dead time
    sensors: Sequence[str] = ()  # outputs that are measured; all if empty
    family: Family | None = None
    observer: Design | None = None  # gives the law an estimate
    dt: float = 0.0  # sampling time, s; 0: continuous
    multiloop_margin: bool = False  # whether the disk margin of all forces at once is asked for

    @cached_property
    def loop(self) -> LinearLoop | None:
        """The closed loop, where there is a law."""
        if self.gains is None:
            return None
        return close_loop(
            self.vehicle, self.gains, self.trim, pade=self.pade, dt=self.dt, observer=self.observer
        )

    @cached_property
    def plant(self) -> ct.StateSpace:
        """Commands to pose and velocity."""
        if self.loop:
            return self.loop.plant
        return linearize(self.vehicle, self.trim, pade=self.pade, dt=self.dt)

    @cached_property
    def system(self) -> ct.StateSpace:
        """What poles are printed of: the closed loop, or the vehicle."""
        return self.loop.closed if self.loop else self.plant

    @cached_property
    def modes(self) -> list[Mode]:
        """Poles, the fastest growing first."""
        return modes(self.system)

    @property
    def growing(self) -> list[Mode]:
        """Modes that grow."""
        return [m for m in self.modes if not m.stable]

    @cached_property
    def units(self) -> Mapping[str, str]:
        """Unit of everything that has a name."""
        own = Numeric(self.vehicle).units
        forces = {
            f"force_{d}": "N" if i < 3 else "N m"
            for d, i in zip(self.vehicle.degrees_of_freedom, self.vehicle.dof_indices, strict=True)
        }
        return own | forces | {f"{n}_ref": own[n] for n in self.vehicle.pose_names}

    def require_stable(self) -> None:
        """Refuse what grows."""
        if self.growing:
            mode = self.growing[0]
            remedy = "change the gains" if self.gains else "close the loop with --gains"
            what = f"the loop with '{self.gains.name}'" if self.gains else "this steady motion"
            raise UndertowError(
                f"{what} of '{self.vehicle.name}' is unstable: a mode in {', '.join(mode.states)} grows with "
                f"{mode.rate.real:.4g} 1/s; {remedy}"
            )

    # --- channels -----------------------------------------------------------------------------
    @cached_property
    def _with_force_inputs(self) -> ct.StateSpace:
        """The system with every input that a channel may begin at."""
        return self.system if self.loop else self._add_force_inputs(self.plant)

    def _add_force_inputs(self, plant: ct.StateSpace) -> ct.StateSpace:
        return with_forces(plant, self._forces, commands=True)

    @cached_property
    def _forces(self) -> tuple[list[str], Array]:
        return forces_of(self.vehicle)

    def members_of(self, source: str, output: str | None) -> list[ct.StateSpace]:
        """The same channel of the members of the family; without an output the loop of a force."""
        members = self.family.members[1 : FAMILY.most_drawn] if self.family else ()
        if output is None:
            return [m.loop.single_loop(source) for m in members if m.loop]
        systems = [m.system if m.loop else self._add_force_inputs(m.system) for m in members]
        return [channel(s, output, source) for s in systems]

    def channel(self, source: str, output: str) -> Channel:
        """The channel between an input and an output; "surge" is force_surge, "x" is x_ref."""
        inputs = self._with_force_inputs.input_labels
        known = [n for n in (source, f"force_{source}", f"{source}_ref") if n in inputs]
        if not known:
            refuse_unknown([source], inputs, "", " is not an input", "it has")
        refuse_unknown([output], self._with_force_inputs.output_labels, "", " is not an output", "it has")
        return Channel(known[0], output, channel(self._with_force_inputs, output, known[0]))

    def combined(self, channels: Sequence[Channel]) -> ct.StateSpace:
        """One minimal system from all the inputs of some channels to all their outputs."""
        sources = list(dict.fromkeys(c.source for c in channels))
        outputs = list(dict.fromkeys(c.output for c in channels))
        found = minimal(self._with_force_inputs[outputs, sources])
        states = [f"state_{k}" for k in range(found.nstates)]
        return named(found, states, sources, outputs, "together")

    @cached_property
    def main_channels(self) -> list[Channel]:
        """Each force to its velocity, or each set-point to its coordinate."""
        if self.loop:
            return [self.channel(r, r.removesuffix("_ref")) for r in self.loop.references]
        dofs = self.vehicle.degrees_of_freedom
        names = dict(zip(dofs, self.vehicle.velocity_names, strict=True))
        forces = [n for n in self._with_force_inputs.input_labels if n.startswith("force_")]
        return [self.channel(f, names[f.removeprefix("force_")]) for f in forces]

    def select_channels(self, source: str | None, output: str | None) -> list[Channel]:
        """The channels that are asked for; what is not given is that of the main channels."""
        if source is None and output is None:
            return self.main_channels
        if source is not None and output is not None:
            return [self.channel(source, output)]
        found = [
            c
            for c in self.main_channels
            if output == c.output
            or source in (c.source, c.source.removeprefix("force_"), c.source.removesuffix("_ref"))
        ]
        if found:
            return found
        return [self.channel(source or self.main_channels[0].source, output or self.main_channels[0].output)]

    def margins(self, channels: Sequence[Channel]) -> dict[str, Margins]:
        """Margins: of the loop of each force, or of each channel closed with a gain of one."""
        if self.loop:
            return self.loop.margins
        return {c.name: margins(c.system) for c in channels}

    @cached_property
    def multiloop_disk(self) -> float | None:
        """Disk margin of the loops of all forces at once, where it is asked for."""
        return self.loop.disk if self.loop and self.multiloop_margin else None

    # --- what can be moved and seen -----------------------------------------------------------
    @cached_property
    def controllability(self) -> Subspace:
        """What the commands can move."""
        return controllability(self.plant)

    @cached_property
    def observability(self) -> Subspace:
        """What the sensors show."""
        plant = self.plant
        refuse_unknown(self.sensors, plant.output_labels, "sensor ", " is not an output", "it has")
        names = list(self.sensors or plant.output_labels)
        return observability(named(plant[names, :], plant.state_labels, plant.input_labels, names, "seen"))

    # --- as plain data --------------------------------------------------------------------------
    def content(self, channels: Sequence[Channel]) -> dict[str, Any]:
        """Everything as plain data; what is infinite or undefined is None."""
        trim = self.trim
        found: dict[str, Any] = json_ready(
            {
                "vehicle": self.vehicle.name,
                "gains": self.gains.name if self.gains else None,
                "trim": {
                    name: getattr(trim, name)
                    for name in ("states", "commands", "direction", "turning", "remarks")
                },
                "units": self.units,
                "dt": self.dt or None,
                "stable": not self.growing,
                "modes": [_mode(m) for m in self.modes],
                "zeros": {c.name: c.zeros for c in channels},
                "margins": {n: vars(m) for n, m in self.margins(channels).items()},
                "disk_of_all_forces": self.multiloop_disk,
                "controllability": vars(self.controllability),
                "observability": vars(self.observability),
                "family": self.family and _family(self.family),
            }
        )
        return found


def _mode(mode: Mode) -> dict[str, Any]:
    numbers = {name: getattr(mode, name) for name in ("frequency", "damping", "time_constant")}
    sampled = {"magnitude": mode.magnitude} if mode.dt else {}
    return {"pole": mode.pole, **sampled, **numbers, "states": mode.states}


def _family(found: Family) -> dict[str, Any]:
    return {
        "from": found.spread.source,
        "refused": found.refused,
        "unstable": [m.name for m in found.unstable],
        "members": [
            {"name": m.name, "stable": m.stable, "poles": [q.pole for q in m.modes]} for m in found.members
        ],
    }


def analyse(
    vehicle: Vehicle,
    at: Mapping[str, float] | None = None,
    *,
    free: Sequence[str] = (),
    direction: Mapping[str, int] | None = None,
    gains: str | None = None,
    observer: str | Path | None = None,
    pade: int = 0,
    dt: float = 0.0,
    together: bool = False,
    sensors: Sequence[str] = (),
    family_of: int = 0,
    source: str | Path = "",
    seed: int = 0,
    progress: Progress = lambda done, words: None,
) -> Analysis:
    """The linear analysis of a vehicle at a steady motion.

    `at`, `free` and `direction` are those of `find_trim`; `gains` and `observer` files, or names of bundled
    gains, that close the loop; `pade`, `dt` and `sensors` those of `Analysis`; `together` asks for the disk
    margin of all forces at once. `family_of` vehicles are drawn from the uncertainty of this one, which is
    from the file `source`; a family is of continuous systems, and stands without `dt`.
    """
    law = load_gains(gains, vehicle) if gains else None
    if observer is not None and law is None:
        raise UndertowError(f"observer {observer} is for a law: give one with --gains")
    if together and law is None:
        raise UndertowError("--together is for the loops of a law: give one with --gains")
    if dt and family_of:
        raise UndertowError(f"--family draws continuous systems: leave out --dt {dt:g}, or the family")
    progress(0.1, "finding the trim")
    found = Analysis(vehicle, find_trim(vehicle, at, free=free, direction=direction), law, pade, sensors)
    found.dt, found.multiloop_margin = dt, together
    found.observer = None if observer is None else load_observer(observer, vehicle)
    if family_of:
        progress(0.3, "drawing vehicles")
        path = resolve_vehicle(source)
        found.family = family(
            vehicle,
            found.trim,
            family_of,
            gains=law,
            observer=found.observer,
            pade=pade,
            source=path,
            seed=seed,
        )
    return found


SCHEMA = "undertow/update/2"
STABLE, UNSTABLE, NOT_LINEAR = "stable", "unstable", "no linear form"
_MARGIN_UNITS = {"gain": "", "phase": " deg", "delay": " s", "distance": ""}

Verdicts = Callable[[GainSet], Mapping[str, tuple[str, float | None]]]


@dataclass
class Snapshot:
    """The tracked results of a vehicle and its gain sets, by name, as printed."""

    vehicle: str  # its name
    gains: list[str] = field(default_factory=list)  # gain files that were asked for
    at: list[str] = field(default_factory=list)  # motion that was asked for
    parameters: dict[str, str] = field(default_factory=dict)  # in the signs of the file
    # by loop and the states that take part, numbered where several have the same; 1/s and rad/s
    eigenvalues: dict[str, dict[str, str]] = field(default_factory=dict)
    margins: dict[str, str] = field(default_factory=dict)  # by loop and kind
    verdicts: dict[str, str] = field(default_factory=dict)  # by condition or loop

    def to_json(self) -> str:
        """Text of the state file."""
        return json.dumps({"schema": SCHEMA, **asdict(self)}, indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Snapshot:
        """The snapshot of a state file."""
        try:
            content = json.loads(text)
            if content.pop("schema") != SCHEMA:
                raise UndertowError("it is of another version")
            return TypeAdapter(cls).validate_python(content)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise UndertowError(f"it cannot be read ({error})") from error

    def add_modes(self, name: str, all_modes: Sequence[Mode]) -> None:
        """Poles of a loop, and whether they decay."""
        seen, texts = Counter[str](), self.eigenvalues.setdefault(name, {})
        for mode in all_modes:
            states = ", ".join(mode.states)
            seen[states] += 1
            again = f" ({seen[states]})" if seen[states] > 1 else ""
            turning = f" ± {abs(mode.pole.imag):.6g}i" if mode.pole.imag else ""
            texts[f"{states}{again}"] = f"{mode.pole.real:.6g}{turning}"
        self.verdicts[name] = STABLE if all(m.stable for m in all_modes) else UNSTABLE

    def add_loop(self, name: str, vehicle: Vehicle, gains: GainSet, trim: Trim) -> None:
        """Poles and margins of a loop, where it has a linear form."""
        try:
            loop = close_loop(vehicle, gains, trim)
        except UndertowError:
            self.verdicts[name] = NOT_LINEAR
            return
        self.add_modes(name, modes(loop.closed))
        for force, own in loop.margins.items():
            for kind, unit in _MARGIN_UNITS.items():
                value = getattr(own, kind)
                self.margins[f"{name}, {force}: {kind}"] = f"{value:.4g}{unit}" if isfinite(value) else "any"


def snapshot(
    vehicle: Vehicle,
    gains: Mapping[str, GainSet],
    motion: Mapping[str, float] | None,
    at: Sequence[str] = (),
    conditions: Verdicts | None = None,
) -> Snapshot:
    """All tracked results.

    `motion` is what a trim besides hovering holds, `at` the same in words. `conditions` gives verdicts of the
    conditions on gains and, where it is of interest, their margins, by condition.
    """
    found = Snapshot(vehicle.name, list(gains), list(at), _parameters(vehicle))
    hovering = _hovering(vehicle)
    for name, trim in hovering.items():
        found.add_modes(f"vehicle, hovering{name}", modes(linearize(vehicle, trim)))
    if motion is not None:
        trim = find_trim(vehicle, motion)
        found.add_modes(f"vehicle, {', '.join(at)}", modes(linearize(vehicle, trim)))
    for source, gain_set in gains.items():
        for name, trim in hovering.items():
            found.add_loop(f"{source}, hovering{name}", vehicle, gain_set, trim)
        for name, (verdict, margin) in ({} if conditions is None else conditions(gain_set)).items():
            found.verdicts[f"{source}, {name}"] = verdict
            if margin is not None:
                found.margins[f"{source}, {name}: margin"] = f"{margin:.4g}"
    return found


def _parameters(vehicle: Vehicle) -> dict[str, str]:
    found = {}
    for name in vehicle.parameter_names:
        declared = vehicle.parameter_of(name)
        value = vehicle.value_of(name).value
        shown, unit = (printed(declared, value, vehicle.signs), declared.unit) if declared else (value, "")
        found[name] = f"{shown:.6g} {unit}".strip()
    return found


def _hovering(vehicle: Vehicle) -> dict[str, Trim]:
    """Hovering, for each set of parameters by direction."""
    switched = reversing(vehicle)
    if not switched:
        return {"": find_trim(vehicle)}
    ways = {" forward": 1, " backward": -1}
    return {n: find_trim(vehicle, direction=dict.fromkeys(switched, way)) for n, way in ways.items()}


@dataclass(frozen=True)
class Change:
    """One change, in words; empty if the item is new, or has gone."""

    what: str
    old: str
    new: str


def changes(old: Snapshot, new: Snapshot) -> dict[str, list[Change]]:
    """What has changed, by kind."""
    loops = {**old.eigenvalues, **new.eigenvalues}
    moved = [
        Change(f"{loop}: {change.what}", change.old, change.new)
        for loop in loops
        for change in _changed_poles(old.eigenvalues.get(loop, {}), new.eigenvalues.get(loop, {}))
    ]
    return {
        "parameters": _changed(old.parameters, new.parameters),
        "eigenvalues": moved,
        "margins": _changed(old.margins, new.margins),
        "verdicts": _changed(old.verdicts, new.verdicts),
    }


def _changed(old: Mapping[str, str], new: Mapping[str, str]) -> list[Change]:
    return [Change(n, old.get(n, ""), new.get(n, "")) for n in {**old, **new} if old.get(n) != new.get(n)]


def _changed_poles(old: Mapping[str, str], new: Mapping[str, str]) -> list[Change]:
    """Poles that moved; each is paired with the nearest one that involves the same states."""
    gone, come = ([n for n in a if n not in b] for a, b in ((old, new), (new, old)))
    pairs = [*((n, n) for n in old if n in new), *zip_longest(gone, come, fillvalue="")]
    return [
        Change(b or a, old.get(a, ""), new.get(b, "")) for a, b in pairs if old.get(a, "") != new.get(b, "")
    ]
