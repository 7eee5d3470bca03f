"""Command line: python -m benchmarks.story --help"""

from __future__ import annotations

import sys

from undertow.figures import save_png
from undertow.files import write_whole

from ..shell import Said, aloud, folders
from .page import page, picture
from .steps import FIRST, SECOND, TRIALS, Story


def main(arguments: list[str] | None = None) -> int:
    """Make the page and its picture."""
    with folders("benchmarks.story", __doc__, arguments) as (folder, out):
        said = reported(Story(folder, aloud))
        save_png(picture(folder), out / "images" / "story.png")
        write_whole(out / "story.md", page(said))
    return 0


def reported(story: Story) -> dict[str, Said]:
    """Go through the story: what the commands said."""
    said = {"panels": story.panels(), "new tank": story.new_tank(), "tank": story.tank()}
    said["vehicle"] = story.vehicle()
    said["design"] = story.design("auv.toml", "first.toml", FIRST)
    said["gains on the model"] = story.check("auv.toml", "first.toml", expect=0)
    story.simulate("auv.toml", "first.toml", "on-model.csv")
    said["first on the vehicle"] = story.simulate(
        "auv.toml", "first.toml", "on-vehicle.csv", "--plant", "truth.toml"
    )
    said["first flight"] = story.fly(TRIALS)[0]
    said["diagnosis"] = story.diagnose()
    said["added"] = story.add()
    said["gains on the complete model"] = story.check("complete.toml", "first.toml", expect=1)
    said["second design"] = story.design("complete.toml", "second.toml", SECOND)
    said["gains again"] = story.check("complete.toml", "second.toml", expect=0)
    story.simulate("complete.toml", "second.toml", "second-on-model.csv")
    said["second on the vehicle"] = story.simulate(
        "complete.toml", "second.toml", "second.csv", "--plant", "truth.toml"
    )
    said["code"] = story.write_c()
    return said


if __name__ == "__main__":
    sys.exit(main())
