"""Frames of other people's logs, turned into NED with body axes forward-starboard-down.

The turn from ENU to NED and the turn from FLU to FRD are their own inverses, so one function serves both
ways.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Channels = dict[str, NDArray[np.float64]]

_SWAPPED = {"x": "y", "y": "x"}
# Forward stays forward; left becomes starboard and up becomes down, so every second and third component
# turns.
_FLIPPED_BODY = ("v", "w", "q", "r", "tau_Y", "tau_Z", "tau_M", "tau_N")


def swap_position(channels: Mapping[str, NDArray[np.float64]]) -> Channels:
    """Turn positions from ENU to NED, or back: east and north change places, z changes sign."""
    turned = {_SWAPPED.get(name, name): data for name, data in channels.items()}
    return _negated(turned, ("z",))


def turned_name(name: str, position: str) -> str:
    """Return the name that a channel of the log has after the turn from `position` to NED."""
    return _SWAPPED.get(name, name) if position == "ENU" else name


def swap_attitude(channels: Mapping[str, NDArray[np.float64]]) -> Channels:
    """Turn roll-pitch-yaw of FLU axes in ENU into those of FRD axes in NED, or back.

    Heading counts from north clockwise instead of from east anticlockwise (psi becomes pi/2 - psi), pitch is
    positive nose up instead of nose down, roll is the same.
    """
    turned = _negated(channels, ("theta",))
    if "psi" in turned:
        turned["psi"] = np.pi / 2 - turned["psi"]
    return turned


def swap_body(channels: Mapping[str, NDArray[np.float64]]) -> Channels:
    """Turn body velocities and forces from forward-left-up to forward-starboard-down, or back."""
    return _negated(channels, _FLIPPED_BODY)


def _negated(channels: Mapping[str, NDArray[np.float64]], names: tuple[str, ...]) -> Channels:
    return {name: -data if name in names else data for name, data in channels.items()}
