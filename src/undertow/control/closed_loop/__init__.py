"""Closed loops: a vehicle, its sensors and a controller, simulated in one compiled call."""

from .record import LoopResult, Record
from .scenario import Push, Scenario
from .simulate import Choices, ClosedLoop, Runs, without

__all__ = ["Choices", "ClosedLoop", "LoopResult", "Push", "Record", "Runs", "Scenario", "without"]
