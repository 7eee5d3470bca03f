"""The dive of the tests in every format, and the vehicles that the commands get."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import polars as pl

from tests.identification.logs.ardusub import FULL, write_bin, write_tlog
from tests.identification.logs.dive import Dive, dive
from tests.identification.logs.field import FIELD
from tests.identification.logs.written import bag, mat, mat73, netcdf, ulog
from undertow.model.loading import resolve_vehicle

_OUTPUTS, _NEWTONS = "outputs", "newtons"


@dataclass(frozen=True)
class Kind:
    """A format, how a log of it is made, and what its commands are.

    Attributes
    ----------
    title : str
        What it is called.
    name : str
        Name of the file.
    write : callable
        Writes it into a folder; a real file stands where it is.
    commands : str
        Which vehicle fits: its commands are newtons, outputs of motors, or it is the bundled glider.
    """

    title: str
    name: str
    write: Callable[[Path], Path]
    commands: str = _NEWTONS


def _short() -> Dive:
    """The first half of the dive: enough to try a command on."""
    whole, rows = dive(), 601
    return replace(whole, **{name: getattr(whole, name)[:rows] for name in whole.__dataclass_fields__})


def _table() -> pl.DataFrame:
    run = _short().run
    return pl.DataFrame({"t": run.t, **run.channels})


def _alog(path: Path) -> Path:
    """As pLogger of MOOS writes it: a line for every value, x to east, heading in degrees."""
    d, heading = _short(), np.degrees(_short().pose[:, 5]) % 360.0
    known = {"NAV_X": d.pose[:, 1], "NAV_Y": d.pose[:, 0], "NAV_HEADING": heading}
    known |= {"NAV_SPEED": d.velocity[:, 0], **{f"f{k + 1}": d.thrust[:, k] for k in range(8)}}
    lines = chain.from_iterable(_lines(k, t, known) for k, t in enumerate(d.t.tolist()))
    path.write_text("%%%%\n%% LOG FILE: dive.alog\n" + "".join(lines), encoding="utf-8")
    return path


def _lines(k: int, t: float, known: dict[str, np.ndarray]) -> Iterator[str]:
    for name, values in known.items():
        yield f"{t:.3f} {name} pSim {values[k]:.9g}\n"


def _csv(path: Path) -> Path:
    _table().write_csv(path)
    return path


def _parquet(path: Path) -> Path:
    _table().write_parquet(path)
    return path


def _glider(end: str) -> Callable[[Path], Path]:
    return lambda path: FIELD / "glider" / f"amadeus-2014-204-05-000{end}"


KINDS = (
    Kind("`.bin`", "dive-2026-05-01.bin", write_bin, _OUTPUTS),
    Kind("`.tlog`", "dive-2026-05-01.tlog", write_tlog, _OUTPUTS),
    Kind("`.ulg`", "dive-2026-05-01.ulg", lambda path: ulog(_short()).write(path), _OUTPUTS),
    Kind("`.bag`", "dive-2026-05-01.bag", lambda path: bag(path, _short())),
    Kind("`.db3`", "dive-2026-05-01.db3", lambda path: bag(path, _short())),
    Kind("`.mcap`", "dive-2026-05-01.mcap", lambda path: bag(path, _short())),
    Kind("`.mat`", "dive-2026-05-01.mat", lambda path: mat(path, _short())),
    Kind("`.mat` 7.3", "dive-73-2026-05-01.mat", lambda path: mat73(path, _short())),
    Kind("`.nc`", "dive-2026-05-01.nc", lambda path: netcdf(path, _short())),
    Kind("`.dbd`", "real.dbd", _glider(".dbd"), "glider"),
    Kind("`.ebd`", "real.ebd", _glider(".ebd"), "glider"),
    Kind("`.alog`", "dive-2026-05-01.alog", _alog),
    Kind("`.csv`", "dive-2026-05-01.csv", _csv),
    Kind("`.parquet`", "dive-2026-05-01.parquet", _parquet),
)


def vehicle_for(kind: Kind, folder: Path, motions: str) -> str:
    """Name or path of a vehicle with some degrees of freedom whose commands are those of a log."""
    if kind.commands == "glider":
        return "glider"
    path = folder / f"{kind.commands}-{len(motions)}.toml"
    if not path.exists():
        text = resolve_vehicle("bluerov2").read_text(encoding="utf-8")
        lines = [
            f"degrees_of_freedom = [{motions}]" if line.startswith("degrees_of_freedom") else line
            for line in text.splitlines()
        ]
        text = "\n".join(lines) + "\n"
        text = text.replace("estimate = true", "estimate = true, sigma = 1.0")  # for rollouts
        if kind.commands == _OUTPUTS:
            text = text.replace("[[thrusters]]", f'[[thrusters]]\nthrust_per_command = "{FULL:g} N"')
        path.write_text(text, encoding="utf-8")
    return str(path)
