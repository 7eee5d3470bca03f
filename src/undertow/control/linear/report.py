"""The whole linear analysis of a vehicle at a trim, with or without a law that closes the loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from typing import Any

import control as ct
import numpy as np

from undertow.control.gains import GainSet
from undertow.errors import UndertowError
from undertow.model.catalogue import nearest
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .analysis import (
    Margins,
    Mode,
    Reach,
    channel,
    controllability,
    margins,
    modes,
    observability,
    zeros_of,
)
from .family import Family
from .law_system import forces_of
from .loop import LinearLoop, close_loop
from .numeric import Numeric
from .systems import linearize, named
from .trim import Trim

_MOST_DRAWN = 120


@dataclass(frozen=True)
class Channel:
    """One input and one output, and the minimal system between them.

    Attributes
    ----------
    source, output : str
        Names.
    system : StateSpace
        From one to the other.
    """

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
    """A vehicle at a trim, linear.

    Attributes
    ----------
    vehicle : Vehicle
        The model.
    trim : Trim
        The steady motion.
    gains : GainSet, optional
        The law that closes the loop.
    pade : int
        Order of the approximation of a dead time.
    sensors : sequence of str
        Outputs that are measured; all if empty.
    """

    vehicle: Vehicle
    trim: Trim
    gains: GainSet | None = None
    pade: int = 0
    sensors: Sequence[str] = ()
    family: Family | None = field(default=None)

    @cached_property
    def loop(self) -> LinearLoop | None:
        """The closed loop, where there is a law."""
        if self.gains is None:
            return None
        return close_loop(self.vehicle, self.gains, self.trim, pade=self.pade)

    @cached_property
    def plant(self) -> ct.StateSpace:
        """Commands to pose and velocity."""
        return self.loop.plant if self.loop else linearize(self.vehicle, self.trim, pade=self.pade)

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
        forces = {f"force_{d}": "N" if i < 3 else "N m" for d, i in self._places.items()}
        return own | forces | {f"{n}_ref": own[n] for n in self.vehicle.pose_names}

    @property
    def _places(self) -> dict[str, int]:
        return dict(zip(self.vehicle.degrees_of_freedom, self.vehicle.dof_indices, strict=True))

    # --- channels -----------------------------------------------------------------------------
    @cached_property
    def _wide(self) -> ct.StateSpace:
        """The system with every input that a channel may begin at."""
        return self.system if self.loop else self._widened(self.plant)

    def _widened(self, plant: ct.StateSpace) -> ct.StateSpace:
        names, by_force = self._forces
        whole = ct.ss(
            plant.A,
            np.hstack([plant.B, plant.B @ by_force]),
            plant.C,
            np.hstack([plant.D, plant.D @ by_force]),
        )
        return named(whole, plant.state_labels, [*plant.input_labels, *names], plant.output_labels, "wide")

    @cached_property
    def _forces(self) -> tuple[list[str], Array]:
        return forces_of(self.vehicle)

    def members_of(self, source: str, output: str | None) -> list[ct.StateSpace]:
        """The same channel of the members of the family; without an output the loop of a force."""
        members = self.family.members[1:_MOST_DRAWN] if self.family else ()
        if output is None:
            return [m.loop.cut(source) for m in members if m.loop]
        systems = [m.system if m.loop else self._widened(m.system) for m in members]
        return [channel(s, output, source) for s in systems]

    def channel(self, source: str, output: str) -> Channel:
        """The channel between an input and an output; "surge" is force_surge, "x" is x_ref.

        Raises
        ------
        UndertowError
            If a name is unknown.
        """
        inputs, outputs = self._wide.input_labels, self._wide.output_labels
        known = [n for n in (source, f"force_{source}", f"{source}_ref") if n in inputs]
        if not known:
            raise UndertowError(
                f"'{source}' is no input{nearest(source, inputs)}: it has {', '.join(inputs)}"
            )
        if output not in outputs:
            raise UndertowError(
                f"'{output}' is no output{nearest(output, outputs)}: it has {', '.join(outputs)}"
            )
        return Channel(known[0], output, channel(self._wide, output, known[0]))

    @cached_property
    def main_channels(self) -> list[Channel]:
        """Each force to its velocity, or each set-point to its coordinate."""
        if self.loop:
            return [self.channel(r, r.removesuffix("_ref")) for r in self.loop.references]
        dofs = self.vehicle.degrees_of_freedom
        names = dict(zip(dofs, self.vehicle.velocity_names, strict=True))
        forces = [n for n in self._wide.input_labels if n.startswith("force_")]
        return [self.channel(f, names[f.removeprefix("force_")]) for f in forces]

    def chosen(self, source: str | None, output: str | None) -> list[Channel]:
        """The channels that are asked for; what is not said is that of the main channels."""
        if source is None and output is None:
            return self.main_channels
        if source is not None and output is not None:
            return [self.channel(source, output)]
        found = [
            c for c in self.main_channels if output == c.output or source in (c.source, *_short(c.source))
        ]
        if found:
            return found
        return [self.channel(source or self.main_channels[0].source, output or self.main_channels[0].output)]

    def margins(self, channels: Sequence[Channel]) -> dict[str, Margins]:
        """Margins: of the loop of each force, or of each channel closed with a gain of one."""
        if self.loop:
            return self.loop.margins
        return {c.name: margins(c.system) for c in channels}

    # --- what can be moved and seen -----------------------------------------------------------
    @cached_property
    def controllability(self) -> Reach:
        """What the commands can move."""
        return controllability(self.plant)

    @cached_property
    def observability(self) -> Reach:
        """What the sensors show."""
        plant = self.plant
        odd = [n for n in self.sensors if n not in plant.output_labels]
        if odd:
            raise UndertowError(
                f"sensor '{odd[0]}' is no output{nearest(odd[0], plant.output_labels)}: it has "
                f"{', '.join(plant.output_labels)}"
            )
        rows = [plant.output_labels.index(n) for n in self.sensors or plant.output_labels]
        seen = ct.ss(plant.A, plant.B, plant.C[rows], plant.D[rows])
        names = [plant.output_labels[i] for i in rows]
        return observability(named(seen, plant.state_labels, plant.input_labels, names, "seen"))

    # --- as plain data --------------------------------------------------------------------------
    def content(self, channels: Sequence[Channel]) -> dict[str, Any]:
        """Everything as plain data; what is endless or undefined is None."""
        trim = self.trim
        return _plain(
            {
                "vehicle": self.vehicle.name,
                "gains": self.gains.name if self.gains else None,
                "trim": {
                    "states": dict(trim.states),
                    "commands": dict(trim.commands),
                    "direction": dict(trim.direction),
                    "turning": trim.turning,
                    "remarks": list(trim.remarks),
                },
                "units": dict(self.units),
                "stable": not self.growing,
                "modes": [_mode(m) for m in self.modes],
                "zeros": {c.name: [[z.real, z.imag] for z in c.zeros] for c in channels},
                "margins": {n: vars(m) for n, m in self.margins(channels).items()},
                "controllability": vars(self.controllability),
                "observability": vars(self.observability),
                "family": self.family and _family(self.family),
            }
        )


def _short(source: str) -> tuple[str, str]:
    return source.removeprefix("force_"), source.removesuffix("_ref")


def _mode(mode: Mode) -> dict[str, Any]:
    return {
        "pole": [mode.pole.real, mode.pole.imag],
        "frequency": mode.frequency,
        "damping": mode.damping,
        "time_constant": mode.time_constant,
        "states": list(mode.states),
    }


def _family(found: Family) -> dict[str, Any]:
    return {
        "from": found.spread.source,
        "refused": found.refused,
        "unstable": [m.name for m in found.unstable],
        "members": [
            {"name": m.name, "stable": m.stable, "poles": [[q.pole.real, q.pole.imag] for q in m.modes]}
            for m in found.members
        ],
    }


def _plain(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {str(k): _plain(v) for k, v in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(v) for v in content]
    if isinstance(content, float):
        return float(content) if isfinite(content) else None
    return content
