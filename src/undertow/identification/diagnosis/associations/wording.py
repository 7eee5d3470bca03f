"""What is left in a degree of freedom, in a sentence that claims no cause."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from undertow.model.symbols import DOFS, VELOCITY

from ..result import BetweenRuns, Dependence, Remaining, Spectrum
from .terms import plain_of

_SHOWN_ALIKE = 2
_FASTER = {
    "u": "the faster it moves ahead or astern",
    "v": "the faster it moves sideways",
    "w": "the faster it rises or sinks",
    "p": "the faster it rolls",
    "q": "the faster it pitches",
    "r": "the faster it turns",
    "t": "the longer the run lasts",
}


def sentence(left: Remaining, loud: bool) -> str:
    """One sentence: ``surge: 0.8 N rms is left beyond the noise; 71 % of it goes with |r| u (slows ...)``."""
    if not loud:
        return f"{left.degree_of_freedom}: {left.residual_rms:.2g} {left.unit} rms is left, which is noise"
    size = f"{left.excess_rms:.2g} {left.unit} rms is left beyond the noise"
    parts = list(_parts(left)) or ["it goes with none of the variables in the logs, and no period stands out"]
    return f"{left.degree_of_freedom}: {'; '.join([size, *parts])}"


def _parts(left: Remaining) -> Iterator[str]:
    for told in left.depends_on:
        does = how(told, left.degree_of_freedom, left.unit)
        yield f"{_percent(told.share)} of it goes with {_named(told)} ({does})"
    if left.spectrum is not None:
        yield _period(left.spectrum, left.unit)
    yield from map(_by_run, left.between_runs)


def how(told: Dependence, degree_of_freedom: str, unit: str) -> str:
    """What a term does to the motion, as far as its sign says."""
    coefficients, column = told.coefficients, told.columns[0]
    if len(coefficients) > 1:
        return f"amplitude {float(np.linalg.norm(coefficients)):.2g} {told.units[0]}"
    if not column:
        return f"{coefficients[0]:.2g} {unit}"
    own = VELOCITY[DOFS.index(degree_of_freedom)]
    others = [f for f in column if f != own]
    even = all(f == "t" or f.startswith("|") for f in others)
    if column.count(own) == 1 and even:
        faster = [_FASTER[plain_of(f)] for f in others if plain_of(f) in _FASTER]
        does = f"slows {degree_of_freedom}" if coefficients[0] < 0 else f"drives {degree_of_freedom} on"
        return ", ".join([does, f"the more {' and '.join(faster)}"] if faster else [does])
    return f"{'falls' if coefficients[0] < 0 else 'rises'} as {told.term} grows"


def _named(told: Dependence) -> str:
    others = "".join(f" or {a}" for a in told.alike[:_SHOWN_ALIKE])
    return f"{told.term}{others}"


def _period(spectrum: Spectrum, unit: str) -> str:
    phase = "" if spectrum.in_step else ", another phase in every run"
    size = f"amplitude {spectrum.amplitude:.2g} {unit}, {_percent(spectrum.share)} of it{phase}"
    return f"period {spectrum.period:.3g} s stands out ({size})"


def _by_run(told: BetweenRuns) -> str:
    values = [float(np.linalg.norm(v)) if len(v) > 1 else v[0] for v in told.values.values()]
    return f"the {told.of} differs from run to run ({min(values):.2g} to {max(values):.2g} {told.unit})"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
