"""What is to be reached: one line for each goal of speed."""

from __future__ import annotations

from typing import NamedTuple

EVALUATION = "one evaluation of f in C"
CALL = "call of f from Python"
ROLLOUT = "closed-loop rollout, 240 s at 1 ms, PID"
BATCH = "1000 rollouts"
REGRESSION = "regression, 10^6 samples x 6 rows x 30 parameters"
FIT = "output-error fit, 60 s at 20 Hz, 20 parameters"
DIAGNOSIS = "whole-catalogue diagnosis, 6 DOF, 4 x 100 s at 20 Hz"
LONG = "whole-catalogue diagnosis, 6 DOF, 4 x 300 s at 20 Hz"
COLD = "derive, generate and compile, nothing in the cache"
OURS = "undertow"


class Goal(NamedTuple):
    """Something measured and what it may be.

    Attributes
    ----------
    what : str
        What is done.
    peer : str
        Beside whom; empty if seconds count.
    at_least : float
        How many times as fast as the peer; how many seconds at most where there is no peer.
    commands : str
        Commands of undertow that do it.
    who : str
        Which of our ways.
    """

    what: str
    peer: str
    at_least: float
    commands: str
    who: str = OURS


GOALS = (
    Goal(COLD, "", 1.5, "compare, fit"),
    Goal(EVALUATION, "hand-written C", 1.0, "gains, simulate"),
    Goal(ROLLOUT, "hand-written C", 1 / 0.95, "gains, simulate"),
    Goal(ROLLOUT, "CasADi mapaccum, compiled", 2, "gains, simulate"),
    Goal(ROLLOUT, "NumPy Runge-Kutta", 900, "gains, simulate"),
    Goal(BATCH, "hand-written C, one thread", 5, "gains", "undertow, one thread"),
    Goal(BATCH, "hand-written C, one thread", 9, "gains", "undertow, two threads"),
    Goal(REGRESSION, "NumPy and lstsq", 200, "identify"),
    Goal(REGRESSION, "one pass over the data", 1 / 5, "identify"),
    Goal(FIT, "IPOPT multiple shooting, virtual machine", 100, "fit"),
    Goal(FIT, "SciPy, finite differences on the same simulation", 4, "fit"),
    Goal(DIAGNOSIS, "", 15, "diagnose"),
    Goal(LONG, "", 60, "diagnose"),
)
