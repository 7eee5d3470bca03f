"""Sound files of every kind that is read, for the damage to begin from."""

from __future__ import annotations

import gzip
import io
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from benchmarks.hidden_effects import make_case
from benchmarks.hidden_effects.files import toml_text
from benchmarks.shape.hulls import box_mesh, stl
from undertow.codegen.library import Library
from undertow.control.gains import bundled_gains
from undertow.control.linear.report import Snapshot
from undertow.fleet.diagnose import Store
from undertow.fleet.reduction import Reduced
from undertow.identification.diagnosis.result import (
    Diagnosis,
    Estimate,
    Indistinguishable,
    Ranked,
    RunInfo,
    Step,
)
from undertow.model.loading import bundled_vehicles, load_vehicle

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "src" / "undertow" / "demo_data"
MAPPING = b"""\
schema = "undertow/mapping/1"
description = "What a logger writes"
delimiter = ","
decimal = "."
missing = ["lost", -9999]
ignore = ["battery"]
missing_commands = "gap"

[time]
column = "t"
unit = "s"
offset = 0.5
disorder = "drop"

[frames]
position = "NED"
body = "FRD"

[columns]
x = "x"
y = { channel = "y", unit = "m" }
psi = { channel = "psi", unit = "deg", scale = 57.29577951308232, wrapped = true }
u = { channel = "u", unit = "m/s", scale = 1.0, offset = 0.0 }
v = { channel = "v", fresh = "v" }
r = { channel = "r", optional = true }
f1 = { channel = "f1", power = 1.0 }
f2 = "f2"
f3 = "f3"
"""


@cache
def originals() -> dict[str, tuple[bytes, ...]]:
    """Contents of sound files by the name of their reader."""
    tables = _tables()
    return {
        "log": tables,
        "parts of a log": tables,
        "mapping": (MAPPING, *_read(*ROOT.glob("examples/*/log.toml"), DEMO / "cfd-surge" / "log.toml")),
        "vehicle": (
            surface_vehicle(),
            *_read(*bundled_vehicles().values(), *ROOT.glob("examples/*/vehicle*.toml")),
        ),
        "gains": _read(*bundled_gains().values()),
        "diagnosis": (_diagnosis(),),
        "diagnosis for a plan": (_diagnosis(),),
        "snapshot": (_snapshot(),),
        "manifest": (_manifest(),),
        "STL": _hulls("stl", _text_stl()),
        "OBJ": (_obj(),),
        "MSH": (_MSH,),
        "partition": (_partition(),),
        "store": (_stored(),),
    }


def _read(*paths: Path) -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in sorted(paths))


# --- logs -----------------------------------------------------------------------------------------
@cache
def _case() -> tuple[bytes, bytes]:
    """Vehicle file and log of a surface vehicle, 20 s at 10 Hz."""
    case = make_case("usv", ("ocean_current",), 1, duration=20.0, runs=("multisine",))
    table = pl.DataFrame(case.runs["multisine"]).gather_every(2)
    return toml_text(case.vehicle).encode(), table.write_csv(float_precision=6).encode()


def surface_vehicle() -> bytes:
    """The vehicle file to `surface_log`."""
    return _case()[0]


def surface_log() -> bytes:
    """A log with pose, velocities and three commands, as CSV."""
    return _case()[1]


def _tables() -> tuple[bytes, ...]:
    log = surface_log()
    short = log[: log.index(b"\n", 4000) + 1]
    demo = gzip.decompress((DEMO / "auv" / "holdout.csv.gz").read_bytes())
    return (short, log, demo[: demo.index(b"\n", 30_000) + 1])


def _partition() -> bytes:
    table = pl.read_csv(surface_log()).head(50).with_columns(vehicle=pl.lit("rov7"), day=pl.lit("2026-05-01"))
    packed = io.BytesIO()
    table.write_parquet(packed)
    return packed.getvalue()


# --- what undertow itself writes ------------------------------------------------------------------
def diagnosis(seed: int = 0) -> Diagnosis:
    """A diagnosis with any numbers in it."""
    rng = np.random.default_rng(seed)

    def number() -> float:
        return float(rng.normal() * 10.0 ** rng.integers(-9, 9))

    found = [
        Estimate(name=n, effect=e, value=number(), standard_error=abs(number()), unit="m/s", about="water")
        for n, e in (("V_N", "ocean_current"), ("V_E", "ocean_current"), ("X_0", "constant_force"))
    ]
    alike: dict[str, Any] = {"family": "water", "about": "", "significant": bool(rng.integers(2))}
    alike |= {"explained": 0.9, "improvement": 0.5, "interval": (0.4, 0.6), "p_value": 0.002}
    alike |= {"error_before": 9.0, "error_after": 1 + abs(number())}
    return Diagnosis(
        undertow="0.1.0",
        vehicle="usv",
        degrees_of_freedom=["surge", "sway", "yaw"],
        signs="sname",
        runs=[RunInfo(name="a", source="a.csv", sha256="0", role="train", samples=9, duration=1.5, notes=[])],
        verdict="indistinguishable",
        headline="ocean_current or constant_force is missing",
        effects=["ocean_current"],
        ranking=[
            Ranked(effect="ocean_current", parameters=found[:2], **alike),
            Ranked(effect="constant_force", parameters=found[2:], **alike),
        ],
        steps=[Step(added=[], error=9.0), Step(added=["ocean_current"], error=1.0, ahead={"1 s": 0.02})],
        indistinguishable=[Indistinguishable(effects=["ocean_current", "constant_force"], reason="alike")],
        warnings=[],
        remaining=[],
        parameters=found,
        false_alarm_rate=0.01,
        noise={"u": abs(number())},
        seconds=3.0,
    )


def _diagnosis() -> bytes:
    return diagnosis().model_dump_json(indent=1).encode()


def _snapshot() -> bytes:
    """What `undertow update` remembers."""
    snapshot = Snapshot(
        "mini-auv",
        ["paper-pd"],
        ["u=0.5"],
        parameters={"m": "7.5 kg", "X_u": "-0.142 kg/s"},
        eigenvalues={"vehicle, hovering": {"u": "-0.1", "v, r": "-0.2 ± 0.5i"}},
        margins={"paper-pd, x: gain": "2", "paper-pd, x: phase": "any"},
        verdicts={"paper-pd, condition 1": "holds"},
    )
    return snapshot.to_json().encode()


def _manifest() -> bytes:
    export = Library(load_vehicle("box-hull"))
    return export.manifest.to_json({"model.c": "", "model.h": ""}, "cc 1.0").encode()


def _stored() -> bytes:
    with tempfile.TemporaryDirectory() as name:
        store = Store(Path(name))
        store.put("", "", Reduced(("X_u", "Y_v"), np.triu(np.arange(1.0, 10.0).reshape(3, 3)), 100, 5.0, 40))
        return next(store.folder.iterdir()).read_bytes()


# --- hulls ----------------------------------------------------------------------------------------
def _hulls(suffix: str, *others: bytes) -> tuple[bytes, ...]:
    with tempfile.TemporaryDirectory() as name:
        return stl(box_mesh(), Path(name) / f"box.{suffix}").read_bytes(), *others


def _text_stl() -> bytes:
    facets = []
    for corners in box_mesh().corners.tolist():
        points = "".join(f"   vertex {x:g} {y:g} {z:g}\n" for x, y, z in corners)
        facets.append(f" facet normal 0 0 0\n  outer loop\n{points}  endloop\n endfacet\n")
    return f"solid box\n{''.join(facets)}endsolid box\n".encode()


def _obj() -> bytes:
    mesh = box_mesh()
    points = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in mesh.vertices.tolist())
    faces = "".join(f"f {a + 1} {b + 1}/1 {c + 1}//2\n" for a, b, c in mesh.faces.tolist())
    return f"# box\n{points}{faces}".encode()


_MSH = b"""\
$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
4
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
$EndNodes
$Elements
4
1 2 2 0 1 1 3 2
2 2 2 0 1 1 2 4
3 2 2 0 1 2 3 4
4 2 2 0 1 1 4 3
$EndElements
"""
