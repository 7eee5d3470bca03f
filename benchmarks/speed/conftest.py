"""The fixture of the speed measurements: one action timed, with its accuracy checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pytest


class Speed:
    """Times one way of doing something; `benchmarks.speed.report` reads what it leaves behind."""

    def __init__(self, benchmark: Any) -> None:
        self._benchmark = benchmark

    def __call__(
        self,
        what: str,
        who: str,
        action: Callable[[], object],
        *,
        calls: float = 1,
        apart: float | None = None,
        limit: float | None = None,
        size: float | None = None,
        rounds: int | None = None,
        more: Mapping[str, float | str] | None = None,
    ) -> None:
        """Time `action`.

        Parameters
        ----------
        what : str
            What is done: a key of `goals.GOALS`, or the name of a table of growth.
        who : str
            Who does it: "undertow", or a peer.
        action : callable
            The work.
        calls : float
            How often the action does it, below one for a part of it: times are divided by this.
        apart : float, optional
            Distance of the result from the reference.
        limit : float, optional
            Largest distance that is right; the measurement fails above it.
        size : float, optional
            Size of the problem, for tables of growth.
        rounds : int, optional
            How often a slow action is run; by default the runner decides.
        more : mapping, optional
            Other figures for the page ("megabytes").
        """
        if apart is not None and limit is not None:
            assert apart <= limit, f"{what}, {who}: {apart:.3g} apart, at most {limit:.3g}"
        reported = {"what": what, "who": who, "calls": calls, "apart": apart, "limit": limit, "size": size}
        known = {k: v for k, v in reported.items() if v is not None}
        self._benchmark.extra_info.update(known, **(more or {}))
        self._benchmark.group = what
        if rounds is None:
            self._benchmark(action)
        else:
            self._benchmark.pedantic(action, rounds=rounds, iterations=1, warmup_rounds=int(rounds > 1))

    def elsewhere(
        self, what: str, who: str, seconds: float, *, apart: float, limit: float, more: Mapping[str, float]
    ) -> None:
        """Tell what another process has measured; the rest as for a call."""
        self._benchmark.extra_info["seconds"] = seconds
        self(what, who, lambda: None, apart=apart, limit=limit, rounds=1, more=more)


@pytest.fixture
def speed(benchmark: Any) -> Speed:
    """Times one action."""
    return Speed(benchmark)
