"""How long a vehicle takes from its effects to running code, each time in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from .conftest import Speed
from .goals import COLD, OURS

# Between the imports and the first result; the cache is where XDG_CACHE_HOME says.
_BUILD = """
import json, time
import numpy as np
import undertow.model.loading
from undertow.codegen import Functions, Simulator
from benchmarks.speed import vehicle

model = vehicle.vehicle()
t = [time.perf_counter()]
functions = Functions(model)
t.append(time.perf_counter())
simulator = Simulator(functions, compiled=True)
t.append(time.perf_counter())
x0, u = np.zeros(len(functions.state_names)), np.ones((2, functions.u.numel()))
end = simulator.run(x0, np.array([0.0, 1.0]), u, np.array(functions.values()))[-1]
print(json.dumps({"seconds": [b - a for a, b in zip(t, t[1:])], "end": list(end)}))
"""
_STEPS = ("model", "compiled code")
_ROUNDING = 1e-12


def _build(cache: Path) -> dict:
    done = subprocess.run(
        [sys.executable, "-c", _BUILD],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "XDG_CACHE_HOME": str(cache)},
    )
    return json.loads(done.stdout)


def time_build(speed: Speed, tmp_path: Path) -> None:
    """The best of three processes; the time is that within the process."""
    runs = [_build(tmp_path / str(k)) for k in range(3)]
    best = min(runs, key=lambda run: sum(run["seconds"]))
    apart = float(np.abs(np.array(best["end"]) - runs[0]["end"]).max())
    steps = {k: round(v, 4) for k, v in zip(_STEPS, best["seconds"], strict=True)}
    speed.elsewhere(COLD, OURS, sum(best["seconds"]), apart=apart, limit=_ROUNDING, more=steps)
