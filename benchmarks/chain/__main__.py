"""Command line: python -m benchmarks.chain --help"""

from __future__ import annotations

import sys

from undertow.control.guidance.mission import load_mission
from undertow.figures import save_png
from undertow.files import write_whole

from ..missions import errors, tracks
from ..shell import Said, aloud, folders
from .page import estimates, page, picture
from .steps import FLIGHTS, MISSION, Chain


def main(arguments: list[str] | None = None) -> int:
    """Make the page and its picture."""
    with folders("benchmarks.chain", __doc__, arguments) as (folder, out):
        chain = Chain(folder, aloud)
        said, gains = worked(chain)
        images = out / "images"
        save_png(picture(folder), images / "chain.png")
        mission = chain.followed()
        run = {"true": mission}
        save_png(tracks(run, "Four legs, current 0.13 m/s"), images / "chain-mission-track.png")
        save_png(errors(run, "cross track", 1.0, "m"), images / "chain-mission-errors.png")
        save_png(estimates(mission, load_mission(folder / MISSION)), images / "chain-mission-estimates.png")
        write_whole(out / "chain.md", page(said, gains))
    return 0


def worked(chain: Chain) -> tuple[dict[str, Said], dict[str, str]]:
    """Go through the chain: what the commands said, and both gain files."""
    said, gains = {}, {}
    chain.fly(FLIGHTS)
    said["fit"] = chain.fit()
    gains["first"] = chain.tune()
    said["gains on the model"] = chain.check("rov.toml", expect=0)
    said["simulated on the model"] = chain.simulate(out="on-model.csv")
    said["first update"] = chain.update("--gains", "tuned.toml", "--at", "u=0.3")
    said["simulated on the vehicle"] = chain.simulate("--plant", "truth.toml", out="on-vehicle.csv")
    said["gains on the vehicle"] = chain.check("truth.toml", expect=1)
    said["diagnosis"] = chain.diagnose()
    said["added"] = chain.add()
    said["second update"] = chain.update()
    said["gains on the new model"] = chain.check("rov.toml", expect=1)
    gains["second"] = chain.tune()
    said["gains tuned anew"] = chain.check("rov.toml", expect=0)
    said["third update"] = chain.update()
    said["simulated anew"] = chain.simulate("--plant", "truth.toml", out="anew.csv")
    said["observer"] = chain.observe()
    said["gains on legs"] = chain.check_legs()
    said["gains with the observer"] = chain.check("rov.toml", 0, "--observer", "observer.toml")
    said["mission"] = chain.follow()
    said["code"] = chain.write_c()
    return said, gains


if __name__ == "__main__":
    sys.exit(main())
