"""Every reader, whatever the file holds: something sound, or one line; and what is written is read again."""

from __future__ import annotations

import gzip
import io
import os
import random
import tomllib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import tomlkit
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from benchmarks.fuzz.cases import COMMANDS, SHARES, Case, case, damage_to, sound_files
from benchmarks.fuzz.judging import outcome, reported
from benchmarks.fuzz.mutations import Mutation, mutated, parquet, zipped
from benchmarks.fuzz.originals import diagnosis, originals
from benchmarks.fuzz.readers import READERS, refusal
from benchmarks.shape.hulls import spheroid_mesh, stl
from tests.quick import first_quick
from undertow.cli.control.simulate import ScenarioOptions, ScheduleOptions
from undertow.cli.main import run
from undertow.control.closed_loop import Scenario
from undertow.control.gains import GainTable, gains_from_table, load_gains
from undertow.control.linear.report import Snapshot
from undertow.errors import UndertowError
from undertow.fleet.diagnose import Store
from undertow.fleet.reduction import Reduced
from undertow.identification.diagnosis.result import Diagnosis, read_diagnosis
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.mapping import LogMapping, read_mapping
from undertow.identification.logs.reading import read_log
from undertow.identification.planning.rivals import Diagnosed
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.saving import save_vehicle
from undertow.paper.tables import _numbers, appendix  # the reader of one cell
from undertow.shape.mesh import read_hull

one_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
FINITE = st.floats(-1e12, 1e12)
SEEDS = st.integers(0, 2**32 - 1)


# --- anything that may stand in a file ------------------------------------------------------------
@pytest.mark.parametrize("name", READERS)
def test_sound_files_are_read(name: str, tmp_path: Path) -> None:
    for content in originals()[name]:
        path = tmp_path / f"sound{READERS[name].suffix}"
        path.write_bytes(content)
        assert refusal(READERS[name], path) == ""


@pytest.mark.parametrize("name", READERS)
@settings(one_folder, max_examples=30)
@given(content=st.binary(max_size=200) | st.text(max_size=100).map(str.encode))
def test_any_bytes_are_read_or_refused_in_one_line(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"any{READERS[name].suffix}"
    path.write_bytes(content)
    refusal(READERS[name], path)


def _read_damaged(
    name: str, seed: int, among: Sequence[Mutation], folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rng, reader = random.Random(seed), READERS[name]
    path = folder / f"damaged{reader.suffix}"
    path.write_bytes(mutated(rng.choice(originals()[name]), rng, among))
    refusal(reader, path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", READERS)
@settings(one_folder, max_examples=25)
@given(seed=SEEDS)
def test_any_damage_is_read_or_refused_in_one_line(
    name: str, seed: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Of tables as text: the slow test packs them, too."""
    among = [m for m in damage_to(name) if m not in (parquet, zipped)]
    _read_damaged(name, seed, among, tmp_path, capfd)


HUGE = b"9" * 400
# What was once taken, or ended in a traceback: the word that is replaced, and what stands there instead.
ODD = [
    ("snapshot", b'"7.5 kg"', b"7.5"),
    ("snapshot", b'"-0.1"', b"null"),
    ("snapshot", b'"any"', b'{"phase": "any"}'),
    ("snapshot", b'"holds"', b"[]"),
    ("diagnosis", b'"error_before": 9.0', b'"error_before": 1e400'),
    ("diagnosis", b'"prior": null', b'"prior": ' + HUGE),
    ("diagnosis for a plan", b'"value": ', b'"value": 1e400'),
    ("MSH", b"$Nodes", b"$Noodles"),
    ("MSH", b"2 1 0 0", b"2 1 0 x"),
]


@pytest.mark.parametrize(("name", "word", "odd"), ODD)
def test_values_that_cannot_be_are_refused(
    name: str, word: bytes, odd: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    sound, path = originals()[name][0], tmp_path / f"odd{READERS[name].suffix}"
    assert word in sound
    path.write_bytes(sound.replace(word, odd, 1))
    assert refusal(READERS[name], path)
    assert capfd.readouterr() == ("", "")  # a library has nothing to say beside it


@pytest.mark.parametrize(
    ("word", "odd"),
    [
        (b'"added_mass"', b"1e400"),
        (b'"added_mass"', b"{}"),
        (b'"name": "x"', b'"name": [0]'),
        (b'"box-hull"', b'"\\u001b[2J"'),
        (b'"model.c":', b'"\\u202e":'),
        (b"0.5063900411009399", HUGE),
    ],
)
def test_generated_code_with_an_odd_manifest_is_stale(word: bytes, odd: bytes, tmp_path: Path) -> None:
    sound, path = originals()["manifest"][0], tmp_path / "manifest.json"
    assert word in sound
    path.write_bytes(sound.replace(word, odd, 1))
    report = READERS["manifest"].read(path)
    assert any("generate" in line for line in report.changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
@settings(one_folder, max_examples=1000)
@given(seed=SEEDS)
def test_much_damage_is_read_or_refused_in_one_line(
    name: str, seed: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    _read_damaged(name, seed, damage_to(name), tmp_path, capfd)


WORDS = st.text(max_size=20) | st.sampled_from(
    ["1,2", "1,2,3", "1,nan", "5,0,2,90deg", "1 m,2 ft,1e400", ",", "x=1"]
)
OPTIONAL = st.none() | WORDS
LISTS = st.none() | st.lists(
    WORDS | st.sampled_from(["u=0.2", "X=1:2:3", "x=1e999", "K=nan", "psi=1deg"]), max_size=2
)


@settings(max_examples=200)
@given(to=WORDS, start=OPTIONAL, times=st.tuples(st.floats(), st.floats()), lists=st.tuples(*3 * [LISTS]),
       seed=st.integers(), log=st.none() | st.floats())  # fmt: skip
def test_any_scenario_is_read_or_refused_in_one_line(to, start, times, lists, seed, log) -> None:
    moving, noise, pushes = lists
    names = load_vehicle("box-hull").pose_names
    given = {"start": start, "moving": moving, "push": pushes, "noise": noise, "seed": seed, "log": log}
    duration, dt = times
    _one_line(lambda: _posed(ScenarioOptions(to, duration, dt, **given).scenario(), names))


def _posed(scenario: Scenario, names: tuple[str, ...]) -> None:
    assert 0 < scenario.dt <= scenario.duration < np.inf
    assert np.isfinite([*scenario.pose(scenario.to, names, "set-point").values()]).all()
    assert np.isfinite([*scenario.moving.values(), *scenario.noise.values()]).all()
    assert all(push.begin < push.end and np.isfinite(push.value) for push in scenario.pushes)


@settings(max_examples=100)
@given(order=st.sampled_from([None, "together", "yaw-first"]), gate=OPTIONAL, current=OPTIONAL)
def test_any_schedule_is_read_or_refused_in_one_line(order, gate, current) -> None:
    _one_line(lambda: ScheduleOptions(order=order, gate=gate, current=current).overrides())


def _one_line(read: Callable[[], Any]) -> None:
    words = ""
    try:
        read()
    except UndertowError as error:
        words = str(error)
        assert words
    assert words == "" or words.isprintable()


# --- what is written is read ----------------------------------------------------------------------
@settings(one_folder, max_examples=15)
@given(
    values=arrays(float, (20, 3), elements=FINITE | st.just(float("nan"))),
    steps=arrays(float, 20, elements=st.floats(1e-3, 1e3)),
    kind=st.sampled_from(["csv", "csv.gz", "parquet"]),
)
def test_a_table_comes_back_from_every_kind_of_log(values, steps, kind: str, tmp_path: Path) -> None:
    values[0] = 1.0  # a channel without any value is refused
    table = pl.DataFrame({"t": np.cumsum(steps), **dict(zip(("u", "v", "f1"), values.T, strict=True))})
    path = tmp_path / f"run.{kind}"
    packed = io.BytesIO()
    if kind == "parquet":
        table.write_parquet(packed)
    else:
        table.fill_nan(None).write_csv(packed)
    path.write_bytes(gzip.compress(packed.getvalue()) if kind == "csv.gz" else packed.getvalue())
    run = read_log(path, channels=["f1"], missing_commands="gap")
    np.testing.assert_array_equal(run.t, table["t"])
    np.testing.assert_array_equal(run.matrix(["u", "v", "f1"]), values)
    parts = [part.run for part in LongLog(path, LogMapping(), ("f1",), missing_commands="gap").parts(8, 3)]
    for part in parts:
        at = np.searchsorted(run.t, part.t)
        np.testing.assert_array_equal(part.matrix(["u", "v"]), values[at, :2])
    assert all(b.t[0] <= a.t[-1] < b.t[-1] for a, b in pairwise(parts))
    assert parts[-1].t[-1] == run.t[-1]


NAMES = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=8)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
CHANNELS = st.sampled_from(["x", "psi", "u", "r", "f1"])
COLUMNS = st.fixed_dictionaries(
    {"channel": CHANNELS},
    optional={
        "unit": st.sampled_from(["m", "deg", "knot"]),
        **dict.fromkeys(["scale", "offset"], NUMBERS),
        **dict.fromkeys(["wrapped", "optional"], st.booleans()),
        "power": st.floats(0.01, 9),
        "fresh": NAMES,
    },
)
MAPPINGS = st.fixed_dictionaries(
    {
        "schema": st.just("undertow/mapping/1"),
        "columns": st.dictionaries(NAMES, COLUMNS, max_size=3).filter(
            lambda columns: len({c["channel"] for c in columns.values()}) == len(columns)
        ),
    },
    optional={
        "description": st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
        "time": st.fixed_dictionaries({"column": NAMES, "offset": NUMBERS, "every": st.integers(1, 10**6)}),
        "missing": st.lists(NUMBERS | NAMES, max_size=2),
        "ignore": st.lists(NAMES, max_size=2),
        "water": st.fixed_dictionaries({"velocity": st.lists(NUMBERS, min_size=3, max_size=3)}),
    },
)


@settings(one_folder, max_examples=60)
@given(content=MAPPINGS)
def test_a_mapping_comes_back(content: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "log.toml").write_text(tomlkit.dumps(content), encoding="utf-8")
    assert read_mapping(tmp_path / "log.toml") == LogMapping.model_validate(content)


@settings(one_folder, max_examples=5)
@given(seed=SEEDS)
def test_values_of_a_vehicle_come_back(seed: int, tmp_path: Path) -> None:
    """All that is not zero in a bundled vehicle, at other values."""
    rng, vehicle = np.random.default_rng(seed), load_vehicle("cybership2")
    known = {n: v for n, v in vehicle.values.items() if v.value}
    new = {n: replace(v, value=v.value * rng.uniform(0.99, 1.01)) for n, v in known.items()}
    changed = vehicle.with_values(new)
    template = tmp_path / "template.toml"
    template.write_bytes(bundled_vehicles()["cybership2"].read_bytes())
    save_vehicle(changed, template, tmp_path / "out.toml")
    again = load_vehicle(tmp_path / "out.toml")
    for name, value in changed.values.items():
        assert again.values[name].value == pytest.approx(value.value, rel=1e-9), (
            name
        )  # ten digits are written


GAINS = st.floats(1e-9, 1e9)


@settings(one_folder, max_examples=15)
@given(
    values=st.lists(
        st.fixed_dictionaries(dict.fromkeys(["x", "y", "z", "psi"], GAINS)), min_size=2, max_size=2
    ),
    gate=st.floats(0.01, 3.0),
)
def test_gains_come_back(values: list[dict[str, float]], gate: float, tmp_path: Path) -> None:
    content = tomllib.loads(originals()["gains"][0].decode())
    content["gains"] = dict(zip(content["gains"], values, strict=True))
    content["schedule"] = {"gate": gate}
    (tmp_path / "gains.toml").write_text(tomlkit.dumps(content))
    vehicle = load_vehicle("mini-auv")
    read, meant = (
        load_gains(tmp_path / "gains.toml", vehicle),
        gains_from_table(GainTable.model_validate(content), vehicle),
    )
    assert read.values == meant.values
    for matrix, row in content["gains"].items():
        assert [read.values[f"{matrix}_{c}"] for c in row] == [*row.values()]
    assert read.schedule.gate == gate


@settings(one_folder, max_examples=20)
@given(seed=SEEDS)
def test_a_diagnosis_comes_back(seed: int, tmp_path: Path) -> None:
    path, found = tmp_path / "found.json", diagnosis(seed)
    path.write_text(found.model_dump_json(indent=1))
    assert read_diagnosis(path, Diagnosis) == found
    for_plan = read_diagnosis(path, Diagnosed)
    assert for_plan.values("constant_force") == {e.name: e.value for e in found.parameters}


@settings(max_examples=30)
@given(
    parameters=st.dictionaries(NAMES, NAMES, max_size=3),
    poles=st.dictionaries(NAMES, st.dictionaries(NAMES, NAMES, max_size=2), max_size=2),
    margins=st.dictionaries(NAMES, NAMES, max_size=3),
)
def test_what_an_update_remembers_comes_back(parameters, poles, margins) -> None:
    known = Snapshot("rov", ["pd"], ["u=0.5"], parameters, poles, margins, {"pd": "holds"})
    assert Snapshot.from_json(known.to_json()) == known


@settings(one_folder, max_examples=20)
@given(
    factor=arrays(float, (3, 3), elements=NUMBERS), seconds=st.floats(0, 1e9), samples=st.integers(0, 10**12)
)
def test_a_small_table_of_a_fleet_comes_back(factor, seconds: float, samples: int, tmp_path: Path) -> None:
    store, known = Store(tmp_path), Reduced(("X_u", "ü"), np.triu(factor), samples, seconds, 7)
    store.put("job", "log", known)
    again = store.get("job", "log")
    assert again is not None
    np.testing.assert_array_equal(again.factor, known.factor)
    assert (again.names, again.samples, again.seconds, again.entries) == (known.names, samples, seconds, 7)
    assert store.get("job", "another log") is None


@settings(one_folder, max_examples=15)
@given(length=st.floats(0.1, 50), share=st.floats(0.05, 1.0), kind=st.sampled_from(["stl", "obj"]))
def test_a_hull_comes_back(length: float, share: float, kind: str, tmp_path: Path) -> None:
    mesh = spheroid_mesh(length, share * length, 2)
    path = tmp_path / f"hull.{kind}"
    if kind == "stl":
        stl(mesh, path)
    else:
        points = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.vertices.tolist())
        path.write_text(points + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in mesh.faces.tolist()))
    again = read_hull(path).mesh
    assert again.volume == pytest.approx(mesh.volume, rel=1e-5 if kind == "stl" else 1e-12)  # STL has floats
    np.testing.assert_allclose(again.extents, mesh.extents, rtol=1e-6)


PRINTED = st.from_regex(r"-?[0-9]{1,4}(\.[0-9]{1,5})?", fullmatch=True)


@given(st.lists(st.lists(PRINTED, min_size=3, max_size=3), min_size=1, max_size=4))
def test_printed_tables_stay_as_they_were_printed(rows: list[list[str]]) -> None:
    """Texts, not numbers: a trailing zero says how many digits the paper gives."""
    lines = ["table,quantity,1,2,3", *(f"A1,q{i},{','.join(row)}" for i, row in enumerate(rows))]
    # The only caller reads a file of the package.
    found = _numbers("\n".join(lines))
    assert found == {"A1": {f"q{i}": dict(zip("123", row, strict=True)) for i, row in enumerate(rows)}}


def test_the_tables_of_the_paper_are_whole() -> None:
    for table in appendix().tables:
        assert {*table.quantities} < {*table.printed}
        assert all(float(text) == float(text) for row in table.printed.values() for text in row.values())
        assert table.selected in table.cases


# --- the fuzz target ------------------------------------------------------------------------------
@pytest.mark.parametrize("reader", first_quick(COMMANDS, 2))
def test_commands_have_an_answer_to_sound_files(reader: str, tmp_path: Path) -> None:
    """Else the damage would be told by nothing but a command that refuses everything."""
    command = COMMANDS[reader][0]
    found = outcome(Case("0", reader, sound_files(reader, command)[0], command), tmp_path)
    assert found.said in ("answered yes", "answered no"), found


def test_a_case_is_made_again_by_its_name() -> None:
    cases = [case(7, number) for number in range(200)]
    assert cases == [case(7, number) for number in range(200)]
    assert {c.reader for c in cases} >= {"vehicle", "gains", "mapping", "log"}
    assert {*SHARES} == {*READERS}
    assert any(c.command for c in cases)


def _raises(words: list[str]) -> int:
    return run(lambda: {}["no such key"])


def _odd_code(words: list[str]) -> int:
    return 3


def _prints_beneath(words: list[str]) -> int:
    os.write(2, b" ** On entry to DLASCL parameter number  4 had an illegal value")
    return 0


def _no_number(words: list[str]) -> int:
    print("fit  nan %")
    return 0


def _warns(words: list[str]) -> int:
    warnings.warn("overflow encountered in power", RuntimeWarning, stacklevel=1)
    return 0


def _leaves_a_half(words: list[str]) -> int:
    Path("half.toml").write_text("[")
    return run(lambda: load_vehicle("no such vehicle"))


WRONG = {
    _raises: "traceback: KeyError: 'no such key' at test_readers.py",
    _odd_code: "exit code 3",
    _no_number: "exit code 0 with nan",
    _warns: "a warning of a library",
    _prints_beneath: "a library prints: '** On entry to DLASCL",
    _leaves_a_half: "exit code 2, and left behind half.toml",
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_command_that_does_what_it_must_not_is_found(
    wrong: Callable[[list[str]], int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.fuzz.judging.main", wrong)
    found = outcome(Case("0", "vehicle", b"", "audit {}"), tmp_path)
    assert found.said == "failed"
    assert found.words.startswith(WRONG[wrong])


def test_a_panic_is_reported_with_its_place() -> None:
    class Panic(BaseException):
        pass

    with pytest.raises(Panic) as caught:
        raise Panic("in\nRust")
    assert reported(caught.value).startswith("Panic at test_readers.py:")
    assert reported(caught.value).endswith(": in Rust")
