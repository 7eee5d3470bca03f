"""Frames of other people's logs, turned into NED with body axes forward-starboard-down.

The turn from ENU to NED and the turn from FLU to FRD are their own inverses, so one function serves both
ways.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

Channels = dict[str, Array]

_LINEAR, _ANGLES = ("u", "v", "w"), ("phi", "theta", "psi")

_SWAPPED = {"x": "y", "y": "x"}
# Forward stays forward; left becomes starboard and up becomes down, so every second and third component
# turns.
FLIPPED_BODY = (
    "v", "w", "q", "r", "v_dot", "w_dot", "q_dot", "r_dot", "tau_Y", "tau_Z", "tau_M", "tau_N"
)  # fmt: skip


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
    return _negated(channels, FLIPPED_BODY)


def velocity_to_body(channels: Mapping[str, NDArray[np.float64]], axes: str) -> Channels:
    """Turn u, v, w that are velocities along the axes of NED or ENU into body axes, by the attitude in NED.

    Parameters
    ----------
    channels : mapping
        With psi, in NED; roll and pitch count as zero where they are missing.
    axes : "NED" or "ENU"
        What u, v, w are along: north, east, down or east, north, up.
    """
    linear = _three(channels, _LINEAR)
    north_east_down = linear if axes == "NED" else np.array([linear[1], linear[0], -linear[2]])
    turned = np.einsum("ijn,jn->in", to_body(*_three(channels, _ANGLES)), north_east_down)
    return {**channels, **_present(channels, turned)}


def over_ground(channels: Mapping[str, NDArray[np.float64]], water: Sequence[float]) -> Channels:
    """Add the velocity of the water (NED, m/s) to u, v, w that are measured through the water."""
    drift = np.einsum("ijn,j->in", to_body(*_three(channels, _ANGLES)), np.asarray(water))
    return {**channels, **_present(channels, _three(channels, _LINEAR) + drift)}


def to_body(phi: Array, theta: Array, psi: Array) -> Array:
    """Return R^T (NED to body), (3, 3, n) (Fossen 2021, section 2.2)."""
    (cf, sf), (ct, st), (cp, sp) = ((np.cos(angle), np.sin(angle)) for angle in (phi, theta, psi))
    return np.array(
        [
            [ct * cp, ct * sp, -st],
            [sf * st * cp - cf * sp, sf * st * sp + cf * cp, sf * ct],
            [cf * st * cp + sf * sp, cf * st * sp - sf * cp, cf * ct],
        ]
    )


def _three(channels: Mapping[str, NDArray[np.float64]], names: tuple[str, ...]) -> Array:
    zero = np.zeros_like(next(iter(channels.values())))
    return np.array([channels.get(name, zero) for name in names])


def _present(channels: Mapping[str, NDArray[np.float64]], linear: Array) -> Channels:
    return {name: data for name, data in zip(_LINEAR, linear, strict=True) if name in channels}


def _negated(channels: Mapping[str, NDArray[np.float64]], names: tuple[str, ...]) -> Channels:
    return {name: -data if name in names else data for name, data in channels.items()}
