"""Manoeuvres that determine parameters best, or that best tell rival models apart."""

from .parameters import Planned, plan_parameters
from .rivals import RivalSpec
from .separate import plan_separation
from .setting import Request
from .suggest import suggest

__all__ = ["Planned", "Request", "RivalSpec", "plan_parameters", "plan_separation", "suggest"]
