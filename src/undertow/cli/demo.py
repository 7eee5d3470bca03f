"""Tell the whole story on shipped logs: where models fail, what is missing, and the error falling.

First an AUV whose model lacks something, then a box hull in a flow solver that no simple model explains.
Pictures, reports and vehicle files go into a folder; index.html there has it all.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_OUT = typer.Option("--out", metavar="FOLDER", help="Folder for what is written; it is made.")


def demo(out: Annotated[Path, _OUT] = Path("demo-output")) -> None:
    from undertow.cli._demo.auv import tell_auv
    from undertow.cli._demo.hull import tell_hull
    from undertow.cli._demo.scene import Scene
    from undertow.files import check_folder

    check_folder(out)
    scene = Scene(out)
    tell_auv(scene)
    tell_hull(scene)
    scene.end()
