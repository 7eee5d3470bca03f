"""Hashes: what was worked out is known again by them, and workers see that they have the same files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from typing import Any

from undertow import __version__
from undertow.files import sha256_of
from undertow.identification.weak.residual import WeakModel
from undertow.identification.weak.step import bounds_of, prior_of, reach_of
from undertow.model.composition import Composition
from undertow.model.loading import resolve_vehicle


def digest(content: Any) -> str:
    """SHA-256 of plain data, and of the version of undertow."""
    return hashlib.sha256(json.dumps([__version__, content], sort_keys=True).encode()).hexdigest()


def files_digest(vehicle: str, effects: Sequence[str]) -> str:
    """Hash of the bytes of a vehicle file and of files with effects.

    Raises
    ------
    UndertowError
        If one of them is not there.
    """
    return digest([sha256_of(resolve_vehicle(vehicle)), *map(sha256_of, effects)])


def content_of(model: WeakModel) -> list[Any]:
    """All of a model that its residual, and a step from where it is, follow from; plain data."""
    functions = model.functions
    names = functions.parameter_names
    limits = (*bounds_of(model), *prior_of(model), reach_of(model))
    return [
        _equations(functions.vehicle.composition),
        [[n, *_exact([v])] for n, v in zip(names, functions.values(), strict=True)],
        [*model.free],
        [_exact(values) for values in limits],
    ]


def _equations(of: Composition) -> list[str]:
    """Everything that parameters may occur in: wrenches, the chain from commands to thrust, and sensors."""
    motion = (of.residual, of.wrench_states, of.pose_rate)
    return [str(part) for part in (*motion, *of.chain, of.dead_time, *of.reported, of.report_age)]


def _exact(values: Iterable[float]) -> list[str]:
    return [float(v).hex() for v in values]
