"""Command line: python -m benchmarks.story --help"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from undertow.figures import save_png
from undertow.files import write_whole

from ..shell import Said
from .page import page, picture
from .steps import FIRST, SECOND, Story


def main(arguments: list[str] | None = None) -> int:
    """Make the page and its picture."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.story", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="default: %(default)s")
    parser.add_argument("--keep", type=Path, help="folder for the files of the way, which are kept")
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as passing:
        folder = options.keep or Path(passing)
        folder.mkdir(parents=True, exist_ok=True)
        said = told(Story(folder, lambda words: print(words, file=sys.stderr, flush=True)))
        save_png(picture(folder), options.out / "images" / "story.png")
        write_whole(options.out / "story.md", page(said))
    return 0


def told(story: Story) -> dict[str, Said]:
    """Go through the story: what the commands said."""
    said = {"panels": story.panels(), "new tank": story.new_tank(), "tank": story.tank()}
    said["vehicle"] = story.vehicle()
    said["design"] = story.design("auv.toml", "first.toml", FIRST)
    said["gains on the model"] = story.check("auv.toml", "first.toml", expect=0)
    story.simulate("auv.toml", "first.toml", "on-model.csv")
    said["first on the vehicle"] = story.simulate(
        "auv.toml", "first.toml", "on-vehicle.csv", "--plant", "truth.toml"
    )
    story.fly()
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
