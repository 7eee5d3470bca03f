"""A session on the demo's AUV, with a catalogue of three effects."""

from __future__ import annotations

import shutil
from functools import cached_property
from pathlib import Path

import undertow
from undertow.model.catalogue import catalogue
from undertow.model.effect import Effect
from undertow.workbench.session import LogChoice, Session
from undertow.workbench.tasks import Job

DEMO = Path(undertow.__file__).parent / "demo_data" / "auv"
TRIED = ("ocean_current", "constant_force", "dry_friction")


class FewEffects(Job):
    """Work with a small catalogue: what is tested is the page, not the search."""

    @cached_property
    def known(self) -> dict[str, type[Effect]]:
        return {name: catalogue()[name] for name in TRIED}


def session_of(folder: Path) -> Session:
    """A session on a copy of the demo's vehicle, one log to fit to and one to judge by."""
    vehicle = folder / "vehicle.toml"
    shutil.copy(DEMO / "vehicle.toml", vehicle)
    logs = [LogChoice(path=str(DEMO / "train_1.csv.gz"))]
    logs.append(LogChoice(path=str(DEMO / "holdout.csv.gz"), role="judge"))
    return Session(vehicle=str(vehicle), logs=logs)
