"""Closed loops: a vehicle, its sensors and a controller, simulated in one compiled call."""

from .record import LoopResult, Record
from .scenario import Push, Scenario
from .simulate import ClosedLoop, Overrides, Runs, without_effects

__all__ = ["ClosedLoop", "LoopResult", "Overrides", "Push", "Record", "Runs", "Scenario", "without_effects"]
