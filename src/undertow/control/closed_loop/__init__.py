"""Closed loops: a vehicle, its sensors and a controller, simulated in one compiled call."""

from .choices import Choices, without
from .many import Runs
from .record import LoopResult, Record
from .scenario import Push, Scenario
from .simulate import ClosedLoop

__all__ = ["Choices", "ClosedLoop", "LoopResult", "Push", "Record", "Runs", "Scenario", "without"]
