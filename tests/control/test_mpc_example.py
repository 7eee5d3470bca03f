"""The example of model predictive control, at a small size: it arrives, keeps out and keeps to its limits."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

FILE = Path(__file__).parents[2] / "examples" / "mpc" / "around_a_keep_out.py"


def test_it_arrives_around_the_circle_within_its_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = importlib.util.spec_from_file_location("around_a_keep_out", FILE)
    assert spec is not None
    assert spec.loader is not None
    mpc = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, mpc)
    spec.loader.exec_module(mpc)
    problem = mpc.Problem(goal=(5.0, 0.0, 0.0), centre=(2.5, 0.1), radius=1.0, horizon=20)
    found = mpc.run(problem, 40.0)
    x, u = np.array(found.x), np.array(found.u)
    away = np.hypot(x[:, 0] - 2.5, x[:, 1] - 0.1)
    assert away.min() > 1.0 + problem.margin - 1e-3  # at the samples
    # In between the way is no more than the sagitta of the chord nearer, which the margin is for.
    fine = np.linspace(0, 1, 20)[:, None, None]
    between = (1 - fine) * x[None, :-1, :2] + fine * x[None, 1:, :2]
    assert np.hypot(between[..., 0] - 2.5, between[..., 1] - 0.1).min() > 1.0
    assert away.min() < 1.1  # the circle is in the way
    assert np.abs(u).max() <= problem.limit
    assert np.abs(u).max() > 0.99 * problem.limit  # and the limit counts
    assert np.hypot(x[-1, 0] - 5.0, x[-1, 1]) < 1e-2
    assert np.abs(x[-1, 2:]).max() < 1e-2
