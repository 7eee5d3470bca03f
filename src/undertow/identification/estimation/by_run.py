"""Parameters that have a value of their own in every run: their names, places, and values in one run.

A free parameter ``V_N@dive2`` is the value of ``V_N`` in the run "dive2". All parameters of a model stand in
one vector p: first those of the vehicle, as the equations have them, then the values by run. Residuals and
simulations take the parameters of one run at a time, `RunValues.own`; derivatives go back to the columns of
the free parameters, `RunValues.columns`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.typing import Array, Index

from .pointwise import Cut, Limits

_AT = "@"


def plain(name: str) -> str:
    """The parameter behind a free one: V_N for V_N@dive2."""
    return name.partition(_AT)[0]


def run_of(name: str) -> str:
    """Run that a free parameter belongs to; empty for one of all runs."""
    return name.partition(_AT)[2]


def value_name(name: str, run: str) -> str:
    """Name of the value of a parameter in one run."""
    return f"{name}{_AT}{run}"


def origins(runs: Sequence[Run]) -> tuple[str, ...]:
    """Names of the runs that these are, or are stretches of, each once."""
    return tuple(dict.fromkeys(run.origin for run in runs))


def with_values_by_run(free: Sequence[str], names: Sequence[str], runs: Sequence[str]) -> tuple[str, ...]:
    """Free parameters of which some have a value in every run; of a single run they are what they were."""
    if len(runs) < 2:
        return tuple(free)
    split = [value_name(n, run) for n in free if n in names for run in runs]
    return (*(n for n in free if n not in names), *split)


class RunValues:
    """Where the values of the free parameters of a model are, for each run.

    `known` are values, by names such as V_N@dive2, in runs that are not fitted.
    """

    def __init__(
        self, functions: Functions, free: Sequence[str], known: Mapping[str, float] | None = None
    ) -> None:
        self.known = dict(known or {})
        self.free, self.size = tuple(free), len(functions.parameter_names)
        #: Free parameters as the equations have them, each once.
        self.names = tuple(dict.fromkeys(map(plain, self.free)))
        self._place = {name: i for i, name in enumerate(functions.parameter_names)}
        #: Values by run, in the order in which they stand in p.
        self.split = tuple(n for n in self.free if _AT in n)
        tied = [n for n in self.by_run if n in functions.equal or functions.followers(n)]
        if tied:
            raise UndertowError(
                f"{tied[0]} is tied to another parameter and also has a value in every run: drop the tie, "
                f"or write per_run = false for {tied[0]}"
            )

    @cached_property
    def by_run(self) -> dict[str, list[str]]:
        """Names of the values by run of every parameter that has them."""
        found: dict[str, list[str]] = {}
        for name in self.split:
            found.setdefault(plain(name), []).append(name)
        return found

    @cached_property
    def behind(self) -> Index:
        """Place among `names` of the parameter behind every free one."""
        return np.array([self.names.index(plain(n)) for n in self.free], dtype=np.intp)

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Places of the free parameters in p."""
        after = {name: self.size + i for i, name in enumerate(self.split)}
        return tuple(after[n] if n in after else self._place[n] for n in self.free)

    @cached_property
    def local(self) -> tuple[int, ...]:
        """Places, among the parameters of one run, of those that are free."""
        return tuple(self._place[n] for n in self.names)

    def started(self, stated: Array, start: Mapping[str, float]) -> Array:
        """All parameters with these starting values; a run without one has that of the others."""
        p = np.concatenate([stated, np.zeros(len(self.split))])
        for name, value in start.items():
            if name in self._place:
                p[self._place[name]] = value
        given: dict[str, list[float]] = {}
        for name, value in start.items():
            if _AT in name and plain(name) in self._place:
                given.setdefault(plain(name), []).append(value)
        for name, values in given.items():
            if name not in start:
                p[self._place[name]] = float(np.mean(values))
        for i, name in enumerate(self.split):
            p[self.size + i] = start.get(name, p[self._place[plain(name)]])
        return p

    def own(self, p: Array, run: Run) -> Array:
        """Parameters of the vehicle in one run; a run without values of its own has the means of the others.

        p: (n_parameters + values by run,). Returns (n_parameters,).
        """
        if not (self.split or self.known):
            return p
        found, values = p[: self.size].copy(), dict(zip(self.split, p[self.size :].tolist(), strict=True))
        for name, there in self.by_run.items():
            found[self._place[name]] = float(np.mean([values[n] for n in there]))
        for name, value in (self.known | values).items():
            if run_of(name) == run.origin:
                found[self._place[plain(name)]] = value
        return found

    def columns(self, run: Run) -> Index:
        """Column among the free parameters of each that the equations have; -1 for what is not free there."""
        names = [value_name(n, run.origin) if n in self.by_run else n for n in self.names]
        return np.array([self.free.index(n) if n in self.free else -1 for n in names], dtype=np.intp)

    def spread(self, J: Array, run: Run) -> Array:
        """Derivatives (..., n_names) in the parameters of one run, in those of all (..., n_free)."""
        if not self.split:
            return J
        columns = self.columns(run)
        found = np.zeros((*J.shape[:-1], len(self.free)))
        found[..., columns[columns >= 0]] = J[..., columns >= 0]
        return found


class LimitsByRun(Limits):
    """What parameters can be together, for those of every run."""

    def __init__(self, functions: Functions, values: RunValues, *, dissipative: bool = False) -> None:
        super().__init__(functions, values.local, dissipative=dissipative)
        self._values = values
        names = dict.fromkeys(run_of(n) for n in values.split)
        self._runs = [Run(name, np.zeros(0), {}) for name in names]

    def cuts(self, p: Array) -> list[Cut]:
        """What a step from p has to do for every matrix to be positive in every run."""
        found = ((r, super(LimitsByRun, self).cuts(self._values.own(p, r))) for r in self._runs)
        return [Cut(self._values.spread(c.slope, r), c.lacking) for r, cuts in found for c in cuts]

    def broken(self, p: Array) -> bool:
        """Whether a matrix is not positive in some run."""
        return any(super(LimitsByRun, self).broken(self._values.own(p, r)) for r in self._runs)

    def impossible(self, p: Array) -> list[str]:
        """Names of all matrices that are not positive in some run."""
        found = (super(LimitsByRun, self).impossible(self._values.own(p, r)) for r in self._runs)
        return list(dict.fromkeys(name for names in found for name in names))

    def moved(self, p: Array, step: Array) -> Array:
        """All parameters after a step of the free ones."""
        found = p.copy()
        found[list(self._values.places)] += step
        return found

    def active(self, p: Array) -> list[str]:
        """Names of the limits that hold the parameters back in some run."""
        found = (super(LimitsByRun, self).active(self._values.own(p, r)) for r in self._runs)
        return list(dict.fromkeys(name for names in found for name in names))
