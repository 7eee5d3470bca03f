"""docs/identification.md from the numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.results.text import number, table

from .cfd import Estimate
from .hardships import NOTHING, OUTLIERS, ROBUST, Hardship
from .profile import EXACT
from .study import OUTPUT, RULE, WEAK, Level
from .towing import SPEEDS, Towed, Towing
from .variables import SQUARES, Bias

BIASES = "identification-biases.png"
PARAMETERS = ("m_x", "X_u", "X_u|u|")
_INTRODUCTION = """\
# Identification: the paper's method and the estimators of undertow

The mini-AUV paper estimates added mass and damping from forced motion: velocity and acceleration are smoothed
by Savitzky-Golay filters in eleven ways, followed by ordinary least squares (`undertow identify --method
sg-ls`). undertow keeps that method as a baseline. `undertow fit` uses a weak form (test functions, no
derivative of noise, errors in the right units), output error (simulation), and, where needed, instrumental
variables or prediction error. This page is made by a program (last section).

## The paper's surge experiment with known truth

Force profile P of the paper ({draws} draws, half of them mirrored), 30 s at 0.2 s; m_x = 9.130825 kg, X_u =
0.142306 kg/s, X_u|u| = 5.153776 kg/m. Noise of the velocity as a share of its rms; of the acceleration, which
only the paper's method uses, 0.025 m/s². Weak form and output error get the force as it is held, with a
sample at each of its three jumps. Root mean square error in % of the truth:
"""
_WHY = """\
Why the paper's method is biased: it filters the motion but not the force, so acceleration and force no longer
belong to the same instant where the force jumps; and noise in the regressors biases estimates towards zero.
Without any noise its cases give m_x 1 to 8% too large (case 2 to case 8). Its own standard errors take
smoothed samples as independent and include neither error. At realistic noise, this experiment does not
determine X_u, whatever the estimator; output error reports that.
"""
_CFD = """\
## A box pushed through water, by CFD

The box hull (60.48 kg; potential theory: 20.6 kg of added mass, m_x = 81.1 kg) on two force profiles at 0.2
s, all three parameters free and no stated values. There is no noise, so all differences come from what the
model lacks: a memory of the wake ([its page](examples/cfd-surge.md)), which each method absorbs in different
parameters. Standard errors are those that each method states.
"""


_TOWING = """\
## Towing tests of a model ship

C/S Enterprise I (NTNU; its free runs: [examples](examples/cse1.md)) was towed at {runs} constant speeds up to
0.6 m/s, each for half a minute; one of its free runs under joystick is used as well. Without acceleration,
only the least squares of the paper's method remains, and the added mass is **{mass}** from these tests; a
free run determines it, but hardly the drag. Magnitudes:
"""
_TOWED = """\
Measured: {measured}. The sum of both terms is known far better than either. Samples of one towing run are
correlated (waves in the basin, a 5-Hz filter), and the stated errors depend on what each method takes as
independent. A free run gives the drag at its own speeds, as a sum with all that its model lacks: its
thrusters have a dead band and a delay.
"""
_VARIABLES = """\
## Noise and an unknown current in the regressors

Least squares takes its regressors as exact. A noisy velocity is not: its square is too large by the variance
of the noise, and coefficients of noisy regressors are biased towards zero. An unknown current is a similar
error that no averaging removes. Five minutes in surge at 10 Hz under forces up to 0.6 N that jump every four
seconds, {draws} draws; noise of the velocity as a share of its rms; no acceleration is logged. Bias in % of
the truth ± its standard error over the draws:
"""
_CURRENT = """\
Integrals over test functions remove most of the bias of least squares. The rest shows where the noise is
large compared with the motion, and is removed by instrumental variables (regressors and weights from the
simulated motion) or output error. None of them helps against water that moves at 0.1 or 0.2 m/s while the
model takes the velocity over ground as that through the water (2% noise): that needs the effect
`ocean_current` in the model. (A bias of -100% of X_u is its bound.)
"""
_HARDSHIPS = """\
## Outliers, and forces that nobody logs

One minute in surge at 10 Hz under forces up to 2 N, 0.005 m/s of noise, {draws} draws. Root mean square
error in % of the truth; last column: errors over the standard errors that the method states (1 is right, more
is overconfident):
"""
_HARD = """\
A robust loss costs little without outliers. Prediction error is output error with a disturbance whose
strength, white and wandering, is estimated along with the parameters; without a disturbance it is output
error.
"""


@dataclass(frozen=True)
class Beyond:
    """What the page shows beside profile P.

    Attributes
    ----------
    draws : int
        Of each.
    variables : sequence of Bias
        Errors in variables.
    hardships : sequence of Hardship
        Outliers and disturbances.
    """

    draws: int
    variables: Sequence[Bias]
    hardships: Sequence[Hardship]

    def parts(self) -> Iterator[str]:
        """The sections, Markdown."""
        heads = ("estimator", *(f"{n} [%]" for n in PARAMETERS))
        calm = [b for b in self.variables if not b.current]
        yield _VARIABLES.format(draws=self.draws)
        yield table(("noise", *heads), _biases(calm, lambda b: f"{100 * b.noise:g}%"), left=2)
        yield f"![Bias of mass and quadratic drag against noise and current](images/{BIASES})\n"
        yield _CURRENT
        streaming = [b for b in self.variables if b.current and b.method != SQUARES]
        yield table(("current", *heads), _biases(streaming, lambda b: f"{b.current:g} m/s"), left=2)
        yield _HARDSHIPS.format(draws=self.draws)
        shown = [h for h in self.hardships if h.method not in ROBUST or h.what in (NOTHING, OUTLIERS)]
        yield table(("log", *heads, "errors over stated"), _hard(shown), left=2)
        yield _HARD


def _towing(towing: Towing) -> Iterator[str]:
    yield _TOWING.format(runs=towing.runs, mass=towing.mass)
    heads = ("X_u [kg/s]", "X_u|u| [kg/m]", *(f"drag at {v:g} m/s [N]" for v in SPEEDS))
    yield table(("tests", "estimator", *heads, "by these tests"), map(_towed, towing.rows), left=2)
    pairs = zip(towing.measured, SPEEDS, strict=True)
    yield _TOWED.format(measured=", ".join(f"{force:.2g} N at {v:g} m/s" for force, v in pairs))


def _towed(row: Towed) -> list[str]:
    cells = (f"{v:.3g} ± {s:.1g}" for v, s in zip(row.values, row.errors, strict=True))
    return [row.source, row.method, *cells, *(f"{f:.2g}" for f in row.drag), "; ".join(row.known) or "–"]


def _biases(found: Sequence[Bias], setting: Callable[[Bias], str]) -> Iterator[list[str]]:
    for b in found:
        cells = (f"{number(m, 2)} ± {number(s, 1)}" for m, s in zip(b.mean, b.unsure, strict=True))
        yield [setting(b), b.method, *cells]


def _hard(found: Sequence[Hardship]) -> Iterator[list[str]]:
    for h in found:
        yield [h.what, h.method, *_cells(h.rmse), f"{h.honest:.2f}"]


def page(
    levels: Sequence[Level],
    draws: int,
    cfd: Sequence[Estimate],
    making: str,
    beyond: Beyond | None = None,
    towing: Towing | None = None,
) -> str:
    """The whole page, Markdown."""
    parts = [
        _INTRODUCTION.format(draws=draws),
        table(("noise", "estimator", *(f"{n} [%]" for n in PARAMETERS)), _errors(levels), left=2),
        "![Mass and quadratic drag at 2% noise: bias and spread](images/identification-spread.png)\n",
        "### Goals\n",
        table(("goal", "noise", *PARAMETERS, ""), _goals(levels), left=2),
        _WHY,
        "How often output error calls a parameter identified:\n",
        table(("noise", *PARAMETERS), _known(levels)),
    ]
    parts += [] if beyond is None else beyond.parts()
    if cfd:
        parts += [_CFD, table(("log", "estimator", *PARAMETERS, "by the log"), _box(cfd), left=2)]
    parts += [] if towing is None else _towing(towing)
    tables = "`undertow audit-tables` lists what does not fit in the paper's own tables A1 to A6.\n"
    return "\n".join([*parts, "## The paper's tables\n", tables, making])


def _errors(levels: Sequence[Level]) -> Iterator[list[str]]:
    for level in levels:
        noise = f"{100 * level.noise:g}%"
        yield [noise, "best of the 11 cases, for each parameter", *_cells(level.best_case())]
        yield [noise, "case 11, the paper's choice", *_cells(level.rmse("case 11"))]
        for method in (RULE, WEAK, OUTPUT):
            silent = level.silent(method)
            words = f"{method}, where it gave one ({100 * silent:.0f}% without)" if silent else method
            yield [noise, words, *_cells(level.rmse(method))]
        yield [noise, "Cramér-Rao bound", *_cells(100 * level.bound / EXACT)]


def _cells(values: np.ndarray) -> list[str]:
    return [number(float(v), 2) for v in values]


def _goals(levels: Sequence[Level]) -> Iterator[list[str]]:
    for level in levels:
        noise = f"{100 * level.noise:g}%"
        ratio = level.rmse(OUTPUT) / (100 * level.bound / EXACT)
        yield _goal("output error ≤ 1.10 × bound", noise, ratio, bool(np.all(ratio <= 1.10)))
        bias = np.abs(level.bias(OUTPUT))
        yield _goal("bias < 0.2 standard deviations", noise, bias, bool(np.all(bias < 0.2)))
        gain = level.best_case() / level.rmse(OUTPUT)
        words = "best case over output error (≥ 3 in m_x, ≥ 2 in X_u|u|)"
        yield _goal(words, noise, gain, bool(gain[0] >= 3 and gain[2] >= 2))


def _goal(name: str, noise: str, values: np.ndarray, met: bool) -> list[str]:
    return [name, noise, *(f"{v:.2f}" for v in values), "met" if met else "**not met**"]


def _known(levels: Sequence[Level]) -> Iterator[list[str]]:
    for level in levels:
        yield [f"{100 * level.noise:g}%", *(f"{100 * share:.0f}%" for share in level.known.values())]


def _box(cfd: Sequence[Estimate]) -> Iterator[list[str]]:
    for e in cfd:
        cells = (f"{v:.3g} ± {s:.2g}" for v, s in zip(e.values, e.errors, strict=True))
        yield [e.log, e.method, *cells, "; ".join(dict.fromkeys(e.known)) or "–"]
