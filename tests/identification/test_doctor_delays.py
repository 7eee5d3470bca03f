"""The standard error of a sensor's delay: as large as the error, from 1 Hz on and between samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import run_of, vehicle_of
from undertow.identification.doctor.clocks import latencies
from undertow.identification.doctor.kinematics import Kinematics
from undertow.identification.logs.run import Run
from undertow.model.symbols import POSE, VELOCITY

NOISE = {"x": 0.006, "y": 0.006, "z": 0.003, "psi": 0.001, "u": 0.003, "v": 0.003, "w": 0.003, "r": 0.001}
SOURCES = (("u", "v", "w"), ("r",))


def _sampled(case: Case, rate: float, delay: float, late: tuple[str, ...], seed: int) -> Run:
    """A log at a lower rate, some of its channels late by a time that is no multiple of the steps."""
    (columns,) = case.runs.values()
    rng, t = np.random.default_rng(seed), columns["t"]
    at = np.arange(8.0 + rng.uniform(0.0, 1.0 / rate), t[-1], 1.0 / rate)
    found = {"t": at - at[0]}
    for name, values in columns.items():
        if name in (*POSE, *VELOCITY):
            exact = CubicSpline(t, values)(at - (delay if name in late else 0.0))
            found[name] = exact + NOISE.get(name, 0.001) * rng.standard_normal(len(at))
        elif name != "t":
            found[name] = values[np.searchsorted(t, at + 1e-9, side="right") - 1]
    return run_of("late", found)


@pytest.mark.slow
def test_a_delay_lies_within_two_standard_errors_in_nineteen_of_twenty_logs() -> None:
    off = []
    for seed in range(8):
        case = make_case(("usv", "mini-auv")[seed % 2], (), seed, duration=150.0, noise=0.0, runs=("steps",))
        vehicle = vehicle_of(case)
        for rate in (1.0, 2.0, 5.0):
            for late in SOURCES:
                delay = (0.37, 0.8, 1.5, 2.4)[(seed + len(off)) % 4]
                run = _sampled(case, rate, delay, late, seed)
                kinematics = Kinematics([run], vehicle)
                found = (one for one in latencies(kinematics, [run]) if {*one.names} <= {*late})
                off += [(one.delay - delay) / one.error for one in found]
    assert len(off) > 40
    assert np.mean(np.abs(off) < 2.0) > 0.88
    assert np.sqrt(np.mean(np.square(off))) < 1.3
