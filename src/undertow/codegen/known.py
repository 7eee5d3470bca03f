"""Models that were simulated before: what a simulation needs of them, kept beside the compiled code."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import sympy as sm

import undertow
from undertow.model.symbols import symbol
from undertow.model.vehicle import Vehicle

from .cache import noted
from .functions import Functions
from .rollout import model_source

_PACKAGE = Path(undertow.__file__).parent
# What of the package the equations and their C code follow from.
_ROOMS = ("model", "codegen")
# Functions that those ask for who simulate.
_KEPT = ("outputs", "rest", "dead_time", "quickest")
_OF_AN_EFFECT = {"thrusters", "allocation"}


class KnownFunctions(Functions):
    """Functions of a vehicle, derived only where more is asked for than a plain simulation needs.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    equal : mapping, optional
        As for `Functions`.
    """

    def __init__(self, vehicle: Vehicle, equal: Mapping[str, tuple[str, float]] | None = None) -> None:
        self.vehicle, self.equal = vehicle, dict(equal or {})
        self.symbols: dict[str, ca.SX] = {}
        question = _question(vehicle, self.equal)
        note = None if question is None else json.loads(noted(question, self._note))
        if note is not None and "convert" not in vars(self):
            self._take(note)

    def __getattr__(self, name: str) -> Any:
        """Called for what is not there yet: the model is derived then, with the same symbols."""
        if name.startswith("__") or "convert" in vars(self):
            raise AttributeError(f"{type(self).__name__} has no attribute '{name}'")
        self._derive()
        return getattr(self, name)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        return vars(self).get("_parameter_names") or self.vehicle.parameter_names

    def _note(self) -> str:
        """What is kept, as JSON."""
        functions = {name: getattr(self, name).serialize() for name in _KEPT}  # derives the model first
        return json.dumps(
            {
                "parameters": self.parameter_names,
                "sizes": {name: s.numel() for name, s in self.symbols.items()},
                "memory": [str(x) for x in self._memory],
                "actuators": [str(x) for x in self._chain_rates],
                "functions": functions,
                "model": model_source(self),
            }
        )

    def _take(self, note: dict[str, Any]) -> None:
        self._parameter_names = tuple(note["parameters"])
        self._draw(note["sizes"])
        # States without their rates: whoever asks for these needs the model.
        self._memory, self._chain_rates = (
            {symbol(n): sm.nan for n in note[kind]} for kind in ("memory", "actuators")
        )
        vars(self).update({name: ca.Function.deserialize(text) for name, text in note["functions"].items()})
        self.known_model_source = note["model"]


def _question(vehicle: Vehicle, equal: Mapping[str, tuple[str, float]]) -> str | None:
    """All that the note depends on, or None if that is not known: effects of users may depend on anything."""
    effects = vehicle.all_effects
    if any(not type(e).__module__.startswith("undertow.model.effects.") for e in effects):
        return None
    if any({*vars(e)} - _OF_AN_EFFECT for e in effects):
        return None
    return json.dumps(
        [
            ["simulation", _code(), sm.__version__, ca.__version__, platform.python_version()],
            [e.id for e in effects],
            vehicle.degrees_of_freedom,
            [(t.name, [repr(float(v)) for v in t.wrench]) for t in vehicle.thrusters],
            vehicle.force_channels,
            [n for n in vehicle.values if n in vehicle.sides],
            {name: (other, repr(float(factor))) for name, (other, factor) in sorted(equal.items())},
        ]
    )


@cache
def _code() -> str:
    """Hash of the code that equations follow from."""
    files = sorted(
        p for room in _ROOMS for p in (_PACKAGE / room).rglob("*") if p.suffix in (".py", ".c", ".h")
    )
    hashed = hashlib.sha256()
    for path in files:
        content = path.read_bytes()
        hashed.update(f"{path.relative_to(_PACKAGE)} {len(content)} ".encode())
        hashed.update(content)
    return hashed.hexdigest()
