"""Simulation with steps that the solution asks for: CVODES, for what is smooth or stiff."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from undertow.errors import UndertowError

from .buffers import Evaluator
from .checking import checked_runs
from .functions import Functions
from .problem import Array

_TOLERANCES = (1e-12, 1e-2)
_MOST_STEPS = 100_000


class AdaptiveSimulator:
    """Simulates a vehicle over a log by backward differentiation formulas of varying order and step.

    Where `Simulator` takes fixed Runge-Kutta steps, this follows a tolerance: it is the better choice for
    logs with long intervals, for lags of milliseconds, which are stiff, and to check the fixed steps of a
    simulation. Inputs are held between samples, and the integrator starts anew at each of them, since a
    solver that steps over a change of its inputs does not see it. It runs in CasADi's virtual machine, by
    SUNDIALS (Hindmarsh et al., ACM Transactions on Mathematical Software 31, 2005).

    Parameters
    ----------
    functions : Functions
        The model.
    relative, absolute : float
        Tolerances of each step; the absolute one in SI units, for every state alike.

    Raises
    ------
    UndertowError
        If a tolerance is not between 1e-12 and 1e-2.
    """

    def __init__(self, functions: Functions, *, relative: float = 1e-8, absolute: float = 1e-10) -> None:
        self._functions = functions
        for name, value in (("relative", relative), ("absolute", absolute)):
            if not _TOLERANCES[0] <= value <= _TOLERANCES[1]:
                low, high = _TOLERANCES
                raise UndertowError(f"tolerance {name} = {value:g}: give one from {low:g} to {high:g}")
        self._options = {"reltol": relative, "abstol": absolute, "max_num_steps": _MOST_STEPS}

    def run(self, x0: Array, t: Array, u: Array, p: Array) -> Array:
        """Simulate one run, or a batch of runs.

        Parameters
        ----------
        x0, t, u, p
            As for `Simulator.run`.

        Returns
        -------
        ndarray, shape (n, nx) or (b, n, nx)
            States at the samples; NaN from the first sample on that the solver does not reach.

        Raises
        ------
        UndertowError
            If a shape does not fit, or the times are not finite or decrease.
        """
        start, times, inputs, parameters = checked_runs(self._functions, x0, t, u, p)
        x = np.full((len(start), times.shape[1], start.shape[1]), np.nan)
        for b, first in enumerate(start):
            of_run = (a[b if len(a) > 1 else 0] for a in (times, inputs, parameters))
            self._simulate(x[b], first, *of_run)
        return x[0] if np.ndim(x0) == 1 else x

    def _simulate(self, x: Array, first: Array, t: Array, u: Array, p: Array) -> None:
        x[0] = first
        for i in range(len(t) - 1):
            if not np.isfinite(x[i]).all():
                return
            interval = t[i + 1] - t[i]
            if interval == 0:
                x[i + 1] = x[i]
                continue
            try:
                x[i + 1] = self._interval(x[i], u[i], p, t[i], interval)[0][0, :, 0]
            except RuntimeError:  # CasADi's, for a solver that gave up
                return

    @cached_property
    def _interval(self) -> Evaluator:
        """State at the end of an interval from its start, inputs, parameters, time and length."""
        f = self._functions
        length = ca.SX.sym("length")
        share = ca.SX.sym("share")
        # All intervals are of length one, so that one integrator serves logs of any clock.
        rate = length * ca.substitute(f.x_dot, f.t, f.t + share * length)
        given = ca.vertcat(f.u, f.p, f.t, length)
        problem = {"x": f.x, "p": given, "t": share, "ode": rate}
        solver = ca.integrator("adaptive", "cvodes", problem, 0.0, 1.0, self._options)
        x, parts = ca.MX.sym("x", f.x.numel()), [ca.MX.sym(n, m) for n, m in self._sizes]
        end = solver(x0=x, p=ca.vertcat(*parts))["xf"]
        return Evaluator(ca.Function("interval", [x, *parts], [end]))

    @property
    def _sizes(self) -> list[tuple[str, int]]:
        f = self._functions
        return [("u", f.u.numel()), ("p", f.p.numel()), ("t", 1), ("length", 1)]
