"""Programs for a Cortex-M4, built with Debian's compiler and run under QEMU."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
TOOLS = (COMPILER, EMULATOR)
PACKAGES = "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
CPU = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
# No contraction of a product and a sum, so that numbers are those of other machines.
FLAGS = (*CPU, "-std=c99", "-O2", "-ffp-contract=off", "-ffunction-sections", "-fdata-sections")
_LINK = ("-nostartfiles", "-T", "board.ld", "--specs=rdimon.specs", "-Wl,--gc-sections", "-lm")
# One instruction takes 1 ns; the image AN386 of the board has a Cortex-M4 with FPU.
_MACHINE = ("-M", "mps2-an386", "-icount", "shift=0", "-nographic", "-monitor", "none", "-serial", "none")
SECONDS = 300.0
"""Longest run of a program."""


def missing() -> list[str]:
    """The tools that this machine lacks."""
    return [tool for tool in TOOLS if shutil.which(tool) is None]


def build(folder: Path, sources: Sequence[str], *flags: str) -> Path:
    """A program of sources in a folder, whose own headers are in `src`."""
    for name in ("board.c", "board.ld", "measure.h"):
        shutil.copy(HERE / name, folder / name)
    program = folder / "program.elf"
    command = [COMPILER, *FLAGS, *flags, "-Isrc", "-I.", *sources, "board.c", *_LINK, "-o", program.name]
    _run(command, folder)
    return program


def run(program: Path) -> str:
    """What a program prints."""
    hosted = ("-semihosting-config", "enable=on,target=native")
    return _run([EMULATOR, *_MACHINE, *hosted, "-kernel", program.name], program.parent)


def flash(folder: Path, source: str, *flags: str) -> int:
    """Bytes of code and constants of one source."""
    _run([COMPILER, *FLAGS, *flags, "-Isrc", "-c", source, "-o", "part.o"], folder)
    said = _run(["arm-none-eabi-size", "part.o"], folder)
    code, data = said.splitlines()[1].split()[:2]
    return int(code) + int(data)


def _run(command: Sequence[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=SECONDS)
    if done.returncode:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {done.stderr.strip()[:500]}")
    return done.stdout
