"""What a call from Python costs."""

from __future__ import annotations

import numpy as np

from undertow.codegen import Compiled

from . import vehicle
from .conftest import Speed
from .goals import CALL


def time_function_call(speed: Speed) -> None:
    compiled = Compiled(vehicle.functions(), compiled=True)
    x, u = vehicle.states(1)[0], vehicle.commands(1)[0]
    p = np.array(vehicle.functions().values())
    speed(CALL, "CasADi Function.__call__", lambda: compiled.dynamics(x, u, p, 0.0))
