"""What the tests of closed loops share: the mini-AUV as (9) of the paper, and runs of bundled gains on it."""

from __future__ import annotations

from undertow.control.closed_loop import ClosedLoop, Overrides, Record, Scenario, without_effects
from undertow.control.gains import GainTable, gains_from_table
from undertow.model.loading import load_vehicle

WITH_CORIOLIS = load_vehicle("mini-auv")
AUV = without_effects(WITH_CORIOLIS, ["rigid_body_coriolis", "added_mass_coriolis"])  # model (9) of the paper
GOAL = (-1.0, 1.0, 1.0)
# At exactly zero velocity the mean of the forward and the backward set holds; this is the forward one.
CREEPING = {"u": 1e-12, "w": 1e-12}
_LOOPS: dict[tuple[str, Overrides], ClosedLoop] = {}


AS_FILED = Overrides()


def loop(gains: str, overrides: Overrides = AS_FILED) -> ClosedLoop:
    if (gains, overrides) not in _LOOPS:
        _LOOPS[gains, overrides] = overrides.loop(gains, AUV)
    return _LOOPS[gains, overrides]


def run(gains: str, overrides: Overrides = AS_FILED, **scenario: object) -> Record:
    return loop(gains, overrides).run(Scenario(**({"to": GOAL} | scenario)))  # type: ignore[arg-type]


def law_of(name: str, **gains: float) -> ClosedLoop:
    """A loop with a law by its id and the same gains for every coordinate."""
    content = {
        "schema": "undertow/gains/1",
        "name": name,
        "law": name,
        "gains": gains,
        "unactuated": ["sway"],
    }
    return ClosedLoop(gains_from_table(GainTable.model_validate(content), AUV))
