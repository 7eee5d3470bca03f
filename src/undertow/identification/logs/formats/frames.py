"""Frames of ArduSub: which way each motor pushes, and on which side of the vehicle it sits.

From ``AP_Motors6DOF::setup_motors`` and the values of FRAME_CONFIG in ArduSub's ``Parameters.cpp``
(github.com/ArduPilot/ardupilot). The factors say what each motor does for a demand; throttle counts upwards,
lateral to starboard. Where a bundled vehicle has the frame, its places are known; of the others the factors
tell the sides only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Vector = tuple[float, float, float]


class Factors(NamedTuple):
    """What a motor does for a demand of each motion."""

    roll: float
    pitch: float
    yaw: float
    throttle: float
    forward: float
    lateral: float

    @property
    def direction(self) -> Vector:
        """Which way it pushes at a positive command: forward, starboard, down."""
        pushed = np.array([self.forward, self.lateral, -self.throttle])
        x, y, z = (pushed / np.linalg.norm(pushed)).tolist()
        return x, y, z

    def place(self, arms: Vector) -> Vector:
        """Where it has to sit for the signs of its moments, with arms of these lengths (r x F)."""
        x_push, y_push, z_push = np.sign(self.direction).tolist()
        ahead = self.yaw * y_push - self.pitch * z_push
        aside = self.roll * z_push - self.yaw * x_push
        below = self.pitch * x_push - self.roll * y_push
        x, y, z = (np.sign([ahead, aside, below]) * arms + 0.0).tolist()
        return x, y, z


@dataclass(frozen=True)
class Frame:
    """A frame of ArduSub."""

    name: str
    base: str  # bundled vehicle whose hull is taken
    motors: tuple[Factors, ...]
    bundled: bool = False  # whether that vehicle has the frame itself, so that it knows the places


_LEVEL = (
    Factors(0, 0, 1, 0, -1, 1),
    Factors(0, 0, -1, 0, -1, -1),
    Factors(0, 0, -1, 0, 1, 1),
    Factors(0, 0, 1, 0, 1, -1),
)
_VECTORED = (*_LEVEL, Factors(1, 0, 0, -1, 0, 0), Factors(-1, 0, 0, -1, 0, 0))
_VECTORED_6DOF = (
    *_LEVEL,
    Factors(1, -1, 0, -1, 0, 0),
    Factors(-1, -1, 0, -1, 0, 0),
    Factors(1, 1, 0, -1, 0, 0),
    Factors(-1, 1, 0, -1, 0, 0),
)
_BLUEROV1 = (
    Factors(0, 0, -1, 0, 1, 0),
    Factors(0, 0, 1, 0, 1, 0),
    Factors(-0.5, 0.5, 0, 0.45, 0, 0),
    Factors(0.5, 0.5, 0, 0.45, 0, 0),
    Factors(0, -1, 0, 1, 0, 0),
    Factors(-0.25, 0, 0, 0, 0, 1),
)
_AT_RIGHT_ANGLES = (
    Factors(1, 1, 0, 1, 0, 0),
    Factors(0, 0, 1, 0, 1, 0),
    Factors(1, -1, 0, 1, 0, 0),
    Factors(0, 0, 0, 0, 0, 1),
    Factors(0, 0, 0, 0, 0, 1),
    Factors(-1, 1, 0, 1, 0, 0),
    Factors(0, 0, -1, 0, 1, 0),
    Factors(-1, -1, 0, 1, 0, 0),
)
_SIMPLE = (
    Factors(0, 0, -1, 0, 1, 0),
    Factors(0, 0, 1, 0, 1, 0),
    Factors(0, 0, 0, -1, 0, 0),
    Factors(0, 0, 0, -1, 0, 0),
    Factors(0, 0, 0, 0, 0, 1),
)
FRAMES = {
    0: Frame("BlueROV1", "bluerov2-6", _BLUEROV1),
    1: Frame("Vectored", "bluerov2-6", _VECTORED, bundled=True),
    2: Frame("Vectored_6DOF", "bluerov2", _VECTORED_6DOF, bundled=True),
    3: Frame("Vectored_6DOF_90", "bluerov2", _AT_RIGHT_ANGLES),
    4: Frame("SimpleROV-3", "bluerov2-6", _SIMPLE[:3]),
    5: Frame("SimpleROV-4", "bluerov2-6", _SIMPLE[:4]),
    6: Frame("SimpleROV-5", "bluerov2-6", _SIMPLE),
}
"""By FRAME_CONFIG."""
CUSTOM = 7
"""FRAME_CONFIG of a frame whose motors are in the firmware of its builder only."""
ARMS: Vector = (0.156, 0.111, 0.085)
"""m: how far the level thrusters of the bundled BlueROV2 sit ahead, aside and below."""
