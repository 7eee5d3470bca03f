"""What a vehicle file comes to: parameters, poles, margins and verdicts, and what has changed since."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import isclose
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter

from undertow.control.gains import GainSet
from undertow.errors import UndertowError
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle

from .analysis import Margins, Mode, modes
from .loop import LinearLoop, close_loop
from .numeric import reversing
from .systems import linearize
from .trim import Trim, find_trim

SCHEMA = "undertow/update/1"
STABLE, UNSTABLE, NOT_LINEAR = "stable", "unstable", "no linear form"
_SAME = 1e-9

Number = Annotated[float, Field(allow_inf_nan=False)]
Pole = tuple[Number, Number, list[str]]
Verdicts = Callable[[GainSet], Mapping[str, tuple[str, float | None]]]


@dataclass
class Snapshot:
    """A vehicle and its gain sets in numbers.

    Attributes
    ----------
    vehicle : str
        Name.
    gains, at : list of str
        Gain files and motion that were asked for.
    parameters : dict
        Value and unit by name, in the signs of the file.
    poles : dict
        Real and imaginary part, 1/s and rad/s, and states, by what they are poles of.
    margins : dict
        Numbers by margin, by loop; endless ones are None.
    verdicts : dict of str
        By condition or loop.
    """

    vehicle: str
    gains: list[str] = field(default_factory=list)
    at: list[str] = field(default_factory=list)
    parameters: dict[str, tuple[Number, str]] = field(default_factory=dict)
    poles: dict[str, list[Pole]] = field(default_factory=dict)
    margins: dict[str, dict[str, Number | None]] = field(default_factory=dict)
    verdicts: dict[str, str] = field(default_factory=dict)

    def to_json(self) -> str:
        """Text of the state file."""
        return json.dumps({"schema": SCHEMA, **asdict(self)}, indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Snapshot:
        """The snapshot of a state file.

        Raises
        ------
        UndertowError
            If the text is none.
        """
        try:
            content = json.loads(text)
            if content.pop("schema") != SCHEMA:
                raise UndertowError("it is of another version")
            return TypeAdapter(cls).validate_python(content)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise UndertowError(f"it cannot be read ({error})") from error


# --- taking one -----------------------------------------------------------------------------------
def snapshot(
    vehicle: Vehicle,
    gains: Mapping[str, GainSet],
    motion: Mapping[str, float] | None,
    at: Sequence[str] = (),
    conditions: Verdicts | None = None,
) -> tuple[Snapshot, dict[str, LinearLoop]]:
    """Everything that is to be compared, and the linear loops by name.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    gains : mapping
        Gain sets by the names that they were asked for by.
    motion : mapping, optional
        What a trim besides hovering holds.
    at : sequence of str
        The same in words.
    conditions : callable, optional
        Verdicts of the conditions on gains and, where it is of interest, their margins, by condition.
    """
    found = Snapshot(vehicle.name, list(gains), list(at))
    found.parameters = _parameters(vehicle)
    hovering = _hovering(vehicle)
    for name, trim in hovering.items():
        _add_poles(found, f"vehicle, hovering{name}", modes(linearize(vehicle, trim)))
    if motion is not None:
        trim = find_trim(vehicle, motion)
        _add_poles(found, f"vehicle, {', '.join(at)}", modes(linearize(vehicle, trim)))
    loops: dict[str, LinearLoop] = {}
    for source, gain_set in gains.items():
        for name, trim in hovering.items():
            _add_loop(found, loops, f"{source}, hovering{name}", vehicle, gain_set, trim)
        for name, (verdict, margin) in ({} if conditions is None else conditions(gain_set)).items():
            found.verdicts[f"{source}, {name}"] = verdict
            if margin is not None:
                found.margins[f"{source}, {name}"] = {"margin": float(margin)}
    return found, loops


def _parameters(vehicle: Vehicle) -> dict[str, tuple[float, str]]:
    found = {}
    for name in vehicle.parameter_names:
        declared = vehicle.parameter_of(name)
        value = vehicle.value_of(name).value
        shown = value if declared is None else printed(declared, value, vehicle.signs)
        found[name] = (float(shown), declared.unit if declared else "")
    return found


def _hovering(vehicle: Vehicle) -> dict[str, Trim]:
    """Hovering, for each set of parameters by direction."""
    switched = reversing(vehicle)
    if not switched:
        return {"": find_trim(vehicle)}
    ways = {" forward": 1, " backward": -1}
    return {n: find_trim(vehicle, direction=dict.fromkeys(switched, way)) for n, way in ways.items()}


def _add_poles(found: Snapshot, name: str, all_modes: Sequence[Mode]) -> None:
    found.poles[name] = [(m.pole.real, m.pole.imag, list(m.states)) for m in all_modes]
    found.verdicts[name] = STABLE if all(m.stable for m in all_modes) else UNSTABLE


def _add_loop(
    found: Snapshot, loops: dict[str, LinearLoop], name: str, vehicle: Vehicle, gains: GainSet, trim: Trim
) -> None:
    try:
        loop = close_loop(vehicle, gains, trim)
    except UndertowError:
        found.verdicts[name] = NOT_LINEAR
        return
    loops[name] = loop
    _add_poles(found, name, modes(loop.closed))
    for force, margins in loop.margins.items():
        found.margins[f"{name}, {force}"] = _numbers(margins)


def _numbers(margins: Margins) -> dict[str, float | None]:
    every = {
        "gain": margins.gain,
        "phase": margins.phase,
        "delay": margins.delay,
        "distance": margins.distance,
    }
    return {k: float(v) if np.isfinite(v) else None for k, v in every.items()}


# --- comparing ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Change:
    """One thing that is not as it was.

    Attributes
    ----------
    what : str
        Its name.
    old, new : str
        In words; empty where it was not, or is no more.
    """

    what: str
    old: str
    new: str


def changes(old: Snapshot, new: Snapshot) -> dict[str, list[Change]]:
    """What has changed, by kind: parameters, eigenvalues, margins, verdicts."""
    return {
        "parameters": _changed(old.parameters, new.parameters, _value),
        "eigenvalues": _poles_changed(old, new),
        "margins": [
            Change(f"{loop}: {kind}", a, b)
            for loop in {**old.margins, **new.margins}
            for kind, a, b in _margin_pairs(old.margins.get(loop, {}), new.margins.get(loop, {}))
        ],
        "verdicts": _changed(old.verdicts, new.verdicts, str),
    }


def _changed(old: Mapping[str, Any], new: Mapping[str, Any], told: Callable[[Any], str]) -> list[Change]:
    names = [n for n in {**old, **new} if not _equal(old.get(n), new.get(n))]
    return [Change(n, told(old[n]) if n in old else "", told(new[n]) if n in new else "") for n in names]


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, tuple) and isinstance(b, tuple):
        return a[1] == b[1] and isclose(a[0], b[0], rel_tol=_SAME)
    return bool(a == b)


def _value(entry: tuple[float, str]) -> str:
    return f"{entry[0]:.6g} {entry[1]}".strip()


def _margin_pairs(
    old: Mapping[str, float | None], new: Mapping[str, float | None]
) -> list[tuple[str, str, str]]:
    pairs = []
    for kind in {**old, **new}:
        a, b = old.get(kind), new.get(kind)
        same = a == b or (a is not None and b is not None and isclose(a, b, rel_tol=1e-6, abs_tol=1e-9))
        if not (same and (kind in old) == (kind in new)):
            pairs.append((kind, _margin(old, kind), _margin(new, kind)))
    return pairs


def _margin(margins: Mapping[str, float | None], kind: str) -> str:
    if kind not in margins:
        return ""
    value = margins[kind]
    units = {"phase": " deg", "delay": " s"}
    return "any" if value is None else f"{value:.4g}{units.get(kind, '')}"


def _poles_changed(old: Snapshot, new: Snapshot) -> list[Change]:
    found = []
    for name in {**old.poles, **new.poles}:
        for a, b in _matched(old.poles.get(name, []), new.poles.get(name, [])):
            if a is None or b is None or not _near(a, b):
                states = ", ".join((b or a or (0.0, 0.0, []))[2])
                found.append(Change(f"{name}: {states}", _pole(a), _pole(b)))
    return found


def _near(a: Pole, b: Pole) -> bool:
    return abs(complex(*a[:2]) - complex(*b[:2])) <= 1e-7 * max(abs(complex(*a[:2])), 1e-3)


def _matched(old: Sequence[Pole], new: Sequence[Pole]) -> list[tuple[Pole | None, Pole | None]]:
    """Poles in pairs: those of the same states first of all, then the nearest."""
    from scipy.optimize import linear_sum_assignment

    def price(a: Pole, b: Pole) -> float:
        alien = len({*a[2]} ^ {*b[2]})
        return abs(complex(*a[:2]) - complex(*b[:2])) + 0.3 * alien

    if not old or not new:
        return [*((a, None) for a in old), *((None, b) for b in new)]
    rows, columns = linear_sum_assignment([[price(a, b) for b in new] for a in old])
    pairs: list[tuple[Pole | None, Pole | None]] = [
        (old[i], new[j]) for i, j in zip(rows, columns, strict=True)
    ]
    pairs += [(a, None) for i, a in enumerate(old) if i not in rows]
    return [*pairs, *((None, b) for j, b in enumerate(new) if j not in columns)]


def _pole(pole: Pole | None) -> str:
    if pole is None:
        return ""
    real, imaginary, _ = pole
    return f"{real:.6g}" if not imaginary else f"{real:.6g} ± {abs(imaginary):.6g}i"
