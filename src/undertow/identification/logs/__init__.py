"""Logs: reading measured runs from files, and body velocities from pose where a log has only pose."""

from __future__ import annotations

from undertow.identification.logs.mapping import Mapping, read_mapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run

__all__ = ["Mapping", "Run", "read_log", "read_mapping", "velocities_from_pose"]
