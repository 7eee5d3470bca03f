"""The steps of the story, each a command of undertow, with what it said."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from ..shell import Said, Shell
from ..tank.bodies import AUV_STL, shelf

HERE = Path(__file__).parent
LAG = 0.6
"""Time constant of the thrusters of the true vehicle, s: what the tank cannot know."""
TRIALS = {"trial1": "4,1,1,0.5", "trial2": "1,-3,-0.5,-1", "trial3": "-4,2,1,1.5", "trial4": "-3,-3,0.5,-0.8"}
"""Set-points of the flights of the sea trial; the last one is for validation."""
LOGS = ["trial1.csv", "trial2.csv", "trial3.csv", "--validation", "trial4.csv"]
GOAL = ["--to", "0.15,0.1,0.1,0.1", "--for", "60", "--dt", "0.02", "--log", "0.1"]
HULL = ["--mesh", "hull.stl", "--mass", "7.5", "--dof", "surge,sway,heave,yaw", "--panels", "1600"]
FIRST = ["--error", "x=0.2,y=0.2,z=0.1,psi=0.1", "--force", "surge=4,sway=4,heave=4,yaw=0.5"]
SECOND = ["--error", "x=0.5,y=0.5,z=0.5,psi=0.5", "--force", "surge=1,sway=1,heave=1.5,yaw=0.03"]


class Story(Shell):
    """The story in a folder of its own."""

    def __init__(self, folder: Path, tell: Callable[[str], None] = lambda words: None) -> None:
        super().__init__(folder, tell)
        shutil.copy(AUV_STL, folder / "hull.stl")
        shutil.copytree(shelf("auv"), folder / "tank")
        shutil.copy(HERE / "survey.toml", folder)

    def panels(self) -> Said:
        """What the shape says."""
        return self.undertow("added-mass", "mesh", "hull.stl", "--panels", "1600")

    def new_tank(self) -> Said:
        """Cases for the solver."""
        words = ["--mass", "7.5", "--motion", "surge", "--prescribed", "--out", "new-tank"]
        return self.undertow("tank", "new", "hull.stl", *words)

    def tank(self) -> Said:
        """What the stored logs say."""
        return self.undertow("tank", "run", "tank")

    def vehicle(self) -> Said:
        """The vehicle file, and thrusters in it."""
        said = self.undertow("vehicle", "new", *HULL, "--tank", "tank", "--out", "auv.toml")
        file = self.folder / "auv.toml"
        text = file.read_text(encoding="utf-8")
        lines = text[: text.index("# One table for each thruster")].splitlines()
        kept = [x for x in lines if not x.startswith(("generalised_forces", "# Until thrusters"))]
        thrusters = (HERE / "thrusters.toml").read_text(encoding="utf-8")
        file.write_text("\n".join([*kept, thrusters]), encoding="utf-8")
        true = f'{file.read_text(encoding="utf-8")}\n[effects.thruster_lag]\nT_lag = "{LAG} s"\n'
        (self.folder / "truth.toml").write_text(true, encoding="utf-8")
        return said

    def design(self, vehicle: str, gains: str, asked: list[str]) -> Said:
        """Gains for a model."""
        return self.undertow("design", vehicle, "--law", "pid", *asked, "--out", gains)

    def check(self, vehicle: str, gains: str, expect: int) -> Said:
        """The certificate."""
        return self.undertow("gains", vehicle, gains, "--form", "derived", expect=expect)

    def diagnose(self) -> Said:
        """What the model lacks."""
        return self.undertow("diagnose", "auv.toml", *LOGS)

    def add(self) -> Said:
        """Put it in."""
        return self.undertow("add", "thruster_lag", "auv.toml", *LOGS, "--out", "complete.toml")

    def simulate(self, model: str, gains: str, out: str, *plant: str) -> Said:
        """A run to a set-point."""
        return self.undertow("simulate", model, gains, *plant, *GOAL, "--out", out)

    def write_c(self) -> Said:
        """The controller in C."""
        return self.undertow("export", "c", "complete.toml", "--controller", "second.toml")
