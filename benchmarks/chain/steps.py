"""The steps of the chain, each a command of undertow, with what it said."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from undertow.control.closed_loop import Overrides, Record, Scenario
from undertow.control.guidance.mission import load_mission
from undertow.model.loading import load_vehicle

from ..shell import Said, Shell
from .tuning import gain_file

HERE = Path(__file__).parent
FLIGHTS = {"run1": "8,1,1,0", "run2": "1,8,0,0", "run3": "-6,-6,1,1", "run4": "-7,5,1,-1"}
"""Set-points of the flights that are logged; the last one is for validation."""
MISSION = "four-legs.toml"
GOAL = ["--to", "2,1,1,0", "--for", "240", "--dt", "0.02", "--log", "0.2"]
LOGS = ["run1.csv", "run2.csv", "run3.csv", "--validation", "run4.csv"]


class Chain(Shell):
    """The chain in a folder of its own."""

    def __init__(self, folder: Path, tell: Callable[[str], None] = lambda words: None) -> None:
        super().__init__(folder, tell)
        for name in ("truth.toml", "survey.toml", "four-legs.toml", "without-doppler.toml"):
            shutil.copy(HERE / name, folder / name)
        (folder / "rov.toml").write_text(without_drag((folder / "truth.toml").read_text()))

    # --- steps --------------------------------------------------------------------------------
    def fit(self) -> Said:
        """Fit the model that lacks an effect."""
        return self.undertow("fit", "rov.toml", *LOGS, "--in-place")

    def tune(self) -> str:
        """Tune surge and sway on whatever the model says now; the text of the gain file."""
        text = gain_file(load_vehicle(self.folder / "rov.toml"))
        (self.folder / "tuned.toml").write_text(text)
        return text

    def check(self, vehicle: str, expect: int, *more: str) -> Said:
        """The conditions that are derived from a model."""
        return self.undertow("gains", vehicle, "tuned.toml", "--form", "derived", *more, expect=expect)

    def simulate(self, *plant: str, out: str) -> Said:
        """A run to the goal, on the model or on the true vehicle."""
        return self.undertow("simulate", "rov.toml", "tuned.toml", *plant, *GOAL, "--out", out)

    def update(self, *more: str) -> Said:
        """Everything that follows from the vehicle file."""
        return self.undertow("update", "rov.toml", *more)

    def diagnose(self) -> Said:
        """What the model lacks."""
        return self.undertow("diagnose", "rov.toml", *LOGS)

    def add(self) -> Said:
        """Put it in."""
        return self.undertow("add", "quadratic_damping", "rov.toml", *LOGS, "--in-place")

    # --- the mission --------------------------------------------------------------------------
    def observe(self) -> Said:
        """Make an observer of the model and a log without velocities."""
        words = ["--process", "model", "--current", "--save", "observer.toml"]
        return self.undertow("observe", "rov.toml", "run4.csv", "--map", "without-doppler.toml", *words)

    def check_legs(self) -> Said:
        """The poles on the legs."""
        return self.undertow("gains", "rov.toml", "tuned.toml", "--path", MISSION)

    def follow(self) -> Said:
        """The mission on the true vehicle, the observer in the loop."""
        words = ["--plant", "truth.toml", "--path", MISSION, "--observer", "observer.toml", "--dt", "0.1"]
        return self.undertow("simulate", "rov.toml", "tuned.toml", *words)

    def write_c(self) -> Said:
        """Guidance and law, and the observer, in C."""
        words = ["--controller", "tuned.toml", "--path", MISSION, "--observer", "observer.toml"]
        return self.undertow("export", "c", "rov.toml", *words)

    def followed(self) -> Record:
        """The run of `follow` with everything that pictures need."""
        files = {name: self.folder / f"{name}.toml" for name in ("rov", "truth", "tuned", "observer")}
        mission, model = load_mission(self.folder / MISSION), load_vehicle(files["rov"])
        loop = Overrides().loop(
            files["tuned"], model, load_vehicle(files["truth"]), mission=mission, observer=files["observer"]
        )
        return loop.run(Scenario(duration=mission.simulation_time(model.pose_names), dt=0.1))


def without_drag(text: str) -> str:
    """A vehicle file without its quadratic drag, and with a guess of the linear one."""
    begin, end = text.index("[effects.quadratic_damping]"), text.index("[effects.net_buoyancy]")
    return (text[:begin] + text[end:]).replace('"0.15 kg/s"', '"3 kg/s"')
