"""The closed loop that speed is measured on: PID in six degrees of freedom, sampled every millisecond."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import numpy as np

from undertow.control.closed_loop import ClosedLoop, Scenario
from undertow.control.gains import GainSet, GainTable, gains_from_table

from . import hand, vehicle

TO = (1.0, -0.5, 0.8, 0.1, -0.05, 0.6)
DT, LOGGED = 0.001, 0.04
STRIDE = round(LOGGED / DT)
K_P, K_V, K_I = (60, 60, 60, 12, 12, 10), (60, 60, 70, 6, 6, 5), (6, 6, 8, 1, 1, 1)
SOURCE = Path(__file__).with_name("hand_rollout.c")
# Standard deviation of the mass in a batch, kg.
_SPREAD = 0.2


@cache
def gains() -> GainSet:
    """A PID law that knows the vehicle."""
    content = {
        "schema": "undertow/gains/1",
        "name": "speed",
        "law": "pid",
        "gains": {"K_P": list(K_P), "K_V": list(K_V), "K_I": list(K_I)},
    }
    return gains_from_table(GainTable.model_validate(content), vehicle.vehicle())


@cache
def loop() -> ClosedLoop:
    """It and the vehicle, compiled."""
    return ClosedLoop(gains(), compiled=True)


def scenario(duration: float) -> Scenario:
    """From rest at the origin, in the current, to a pose."""
    return Scenario(TO, duration, DT, log_interval=LOGGED)


def masses(runs: int) -> np.ndarray:
    """Mass of the vehicle in each run of a batch, kg; the first is the true one."""
    spread = np.random.default_rng(3).normal(0, _SPREAD, runs)
    spread[0] = 0.0
    return vehicle.vehicle().value_of("m").value + spread


def allocation() -> np.ndarray:
    """Command of each thruster for a unit of each force, shape (8, 6)."""
    return loop().parts.controller.allocation.pseudo_inverse


# --- by hand ------------------------------------------------------------------------------------
def hand_gains() -> np.ndarray:
    """The same law as `HandGains`."""
    return np.concatenate([K_P, K_V, K_I, allocation().ravel()]).astype(float)


def hand_parameters(mass: float) -> np.ndarray:
    """The vehicle with another mass as `HandParameters`."""
    p = hand.parameters().copy()
    change = mass - vehicle.vehicle().value_of("m").value
    matrix = p[:48].reshape(6, 8)
    matrix[range(3), range(3)] += change
    p[48:96].reshape(6, 8)[:, :6] = np.linalg.inv(matrix[:, :6])
    return p


class HandLoop:
    """hand_rollout.c, compiled."""

    def __init__(self, folder: Path) -> None:
        self._library = hand.library(
            SOURCE.read_text(encoding="utf-8"), folder, "hand_rollout", "-std=gnu99", "-fopenmp"
        )
        self._gains, self._start, self._desired = hand_gains(), np.zeros(12), np.array(TO)

    def run(self, duration: float, masses: np.ndarray, threads: int = 1) -> np.ndarray:
        """States every so often, shape (b, n, 12)."""
        samples = round(duration / DT) + 1
        p = np.array([hand_parameters(m) for m in masses])
        log = np.empty((len(masses), (samples - 1) // STRIDE + 1, 12))
        return self.rerun(p, samples, log, threads)

    def rerun(self, p: np.ndarray, samples: int, log: np.ndarray, threads: int = 1) -> np.ndarray:
        """The same into an array that is there."""
        arrays = (p, self._gains, self._start, self._desired)
        self._library.hand_batch(
            ctypes.c_long(len(p)),
            ctypes.c_int(threads),
            ctypes.c_long(samples),
            ctypes.c_double(DT),
            *(ctypes.c_void_p(a.ctypes.data) for a in arrays),
            ctypes.c_long(STRIDE),
            ctypes.c_void_p(log.ctypes.data),
        )
        return log
