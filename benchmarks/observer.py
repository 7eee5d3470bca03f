"""The picture of docs/observer.md: a dive whose velocities are not measured, in a current.

python -m benchmarks.observer
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from undertow.figures import AFTER, BEFORE, FAINT, FLOOR, INK, figure, look, save_png
from undertow.identification.observe import Observed, observe

from .observer_log import CURRENT, DRIVE, auv, log

EVERY = {"x": 10, "y": 10, "z": 2, "psi": 1, "r": 1}
_WINDOW = 50


def main() -> None:
    """Simulate, observe, draw, and print the errors."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.observer", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images/observer.png"), help="picture to write")
    out: Path = parser.parse_args().out
    run, x, names = log(auv(**CURRENT), 60.0, 7, EVERY)
    walks = {"V_N": 1e-4, "V_E": 1e-4}
    model = observe(auv(), run, process="model", estimated=list(CURRENT), disturbance=DRIVE | walks)
    kinematics = observe(auv(), run)
    for name, found in (("model", model), ("kinematics", kinematics)):
        error = np.std(found.run.channels["u"] - x[:, names.index("u")])
        print(f"{name}: rms error of u {error:.4f} m/s, NIS {found.nis[-1].mean:.3f}; {found.parameters}")
    save_png(picture(model, kinematics, run.t, x[:, names.index("u")]), out)


def picture(model: Observed, kinematics: Observed, t: np.ndarray, u: np.ndarray) -> Any:
    """Surge velocity by kinematics and by the model, the current while it is found, and the NIS."""
    with look():
        drawn, axes = figure(6.0, 2, 2)
        for axis, found, title, colour in (
            (axes[0, 0], kinematics, "kinematics", BEFORE),
            (axes[0, 1], model, "model", AFTER),
        ):
            _band(axis, found.estimate, "u", colour)
            axis.plot(t, u, color=INK, lw=0.8, label="true")
            axis.set(title=f"smoothed by {title}, 2 sigma", ylabel="u, m/s", ylim=(-0.7, 0.7))
            axis.legend(loc="upper right")
        for name, colour in zip(CURRENT, (AFTER, BEFORE), strict=True):
            _band(axes[1, 0], model.filtered, name, colour)
            axes[1, 0].axhline(CURRENT[name], color=INK, lw=0.8, ls=":")
        axes[1, 0].set(title="current, filtered, 2 sigma", ylabel="m/s", ylim=(-0.5, 0.5), xlabel="time, s")
        axes[1, 0].legend()
        _nis(axes[1, 1], model)
    return drawn


def _band(axis: Any, found: Any, name: str, colour: str) -> None:
    i = found.names.index(name)
    mean, spread = found.mean[:, i], 2 * found.deviation[:, i]
    axis.fill_between(found.t, mean - spread, mean + spread, color=colour, alpha=0.25, lw=0)
    axis.plot(found.t, mean, color=colour, label=name)


def _nis(axis: Any, found: Observed) -> None:
    used = found.filtered.used
    square = (found.filtered.innovation**2 / found.filtered.variance)[used]
    t = np.broadcast_to(found.filtered.t[:, None], used.shape)[used]
    low, high = chi2.ppf([0.025, 0.975], _WINDOW) / _WINDOW
    axis.axhspan(low, high, color=FLOOR, alpha=0.2, lw=0, label="95%")
    axis.axhline(1.0, color=FAINT, lw=0.6)
    mean = np.convolve(square, np.full(_WINDOW, 1 / _WINDOW), "valid")
    axis.plot(t[_WINDOW - 1 :], mean, color=INK, lw=0.8)
    axis.set(title="NIS, mean of fifty", xlabel="time, s", ylim=(0, 2.5))
    axis.legend()


if __name__ == "__main__":
    main()
