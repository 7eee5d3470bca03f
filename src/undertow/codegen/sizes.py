"""What a C library takes on a board: flash and stack, as a compiler counts them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from undertow.errors import UndertowError

from .library import Library


class Size(NamedTuple):
    """Bytes of stack of one function."""

    function: str
    stack: int


def sizes(library: Library, compiler: str, *flags: str) -> tuple[dict[str, int], list[Size]]:
    """Bytes of code and constants of each module, and of stack of each function, with -Os."""
    if shutil.which(compiler) is None:
        raise UndertowError(f"compiler '{compiler}' is not there: install it (Debian: gcc-arm-none-eabi)")
    with TemporaryDirectory() as place:
        folder = library.write(Path(place)).folder
        modules: dict[str, int] = {}
        stacks: list[Size] = []
        for source in sorted((folder / "src").glob("*.c")):
            command = [compiler, "-std=c99", "-Os", "-fstack-usage", *flags, "-c", source.name]
            done = subprocess.run(command, cwd=source.parent, capture_output=True, text=True, check=False)
            if done.returncode:
                raise UndertowError(
                    f"{compiler} fails on {source.name}: {done.stderr.strip().splitlines()[0]}"
                )
            modules[source.name] = _flash(compiler, source.with_suffix(".o"))
            for line in source.with_suffix(".su").read_text().splitlines():
                where, size, _ = line.split("\t")
                stacks.append(Size(where.rpartition(":")[2], int(size)))
    return modules, stacks


def _flash(compiler: str, module: Path) -> int:
    """Bytes of code and constants of an object file."""
    tool = f"{compiler.removesuffix('gcc')}size" if compiler.endswith("gcc") else "size"
    done = subprocess.run([tool, str(module)], capture_output=True, text=True, check=True)
    text, data = done.stdout.splitlines()[1].split()[:2]
    return int(text) + int(data)
