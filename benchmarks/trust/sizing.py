"""Effects made just so strong that the truth is worth what a case aims at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .cases import Planned
from .grade import addable, oracle_refit
from .material import simulated, written_to_memory

#: Looks at a case while its strength is chosen; relative deviation that is good enough.
_LOOKS, _NEAR = 5, 0.1
#: Largest factor by which the strength changes from one look to the next.
_STRIDE = 30.0
_MILDER = 0.2
#: Times the drawn size up to which an effect belongs to a vehicle of its kind; beyond, there would be ships
#: with the cross-flow drag of a thousand ships.
LARGEST = 10.0


def sized(case: Planned) -> Planned:
    """The case with its strength, chosen where it aims at what the truth is to be worth.

    What exceeds the noise grows about as the square of a small effect; a few looks do for effects that do
    not. Where the largest size is not worth as much, that is the case. The diagnosis takes no part in this.
    """
    if not case.aim:
        return case
    strength, found = 1.0, {}
    for _ in range(_LOOKS):
        try:
            ratio = _worth(replace(case, strength=strength))
        except ValueError:  # it runs away
            strength *= _MILDER
            continue
        found[strength] = abs(float(np.log(ratio / case.aim)))
        if found[strength] < _NEAR:
            break
        factor = np.sqrt((case.aim**2 - 1.0) / max(ratio**2 - 1.0, 1e-3))
        strength = min(strength * float(np.clip(factor, 1.0 / _STRIDE, _STRIDE)), LARGEST)
        if strength in found:
            break
    if not found:
        raise ValueError(f"{case.id}: the vehicle runs away with any size of its effect that was tried")
    return replace(case, strength=min(found, key=found.__getitem__))


def _worth(case: Planned) -> float:
    made = simulated(case)
    vehicle, train, test = written_to_memory(made)
    truth = made.truth["effects"]
    if not all(addable(vehicle, effect) for effect in truth):
        return case.aim
    values = {k: v for name in case.hidden for k, v in made.truth["values"][name].items()}
    return oracle_refit(vehicle, train, test, truth, values).ratio
