"""What is kept of a session, and what stretches of logs become."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.workbench.demo_session import DEMO, session_of
from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Edit, LogMapping, as_toml, read_edits
from undertow.identification.logs.run import Run
from undertow.workbench.session import LogChoice, LogSegment, ModelStep, Remedy, Session, Workspace


def _roles(choice: LogChoice) -> list[tuple[float, float, str]]:
    return [(s.start, s.end, s.role) for s in choice.spans(0.0, 60.0)]


def test_the_last_stretch_counts_where_two_overlap() -> None:
    choice = LogChoice(path="log.csv")
    assert _roles(choice) == [(0.0, 60.0, "train")]
    choice.stretches.append(LogSegment(start=10.0, end=30.0, role="out"))
    choice.stretches.append(LogSegment(start=25.0, end=80.0, role="judge"))
    assert _roles(choice) == [(0.0, 10.0, "train"), (10.0, 25.0, "out"), (25.0, 60.0, "judge")]


def test_a_span_leaves_out_what_lies_around_it() -> None:
    choice = LogChoice.within(Path("log.csv"), "judge", (5.0, 20.0))
    assert _roles(choice) == [(0.0, 5.0, "out"), (5.0, 20.0, "judge"), (20.0, 60.0, "out")]
    assert _roles(LogChoice.within(Path("log.csv"), "train", (None, None))) == [(0.0, 60.0, "train")]


def test_neighbours_that_are_used_alike_are_one_stretch() -> None:
    choice = LogChoice(path="log.csv", stretches=[LogSegment(start=10.0, end=30.0, role="out")])
    choice.stretches.append(LogSegment(start=20.0, end=30.0, role="train"))
    assert _roles(choice) == [(0.0, 10.0, "train"), (10.0, 20.0, "out"), (20.0, 60.0, "train")]


def test_every_sample_is_in_one_part() -> None:
    t = np.arange(0.0, 60.0, 0.5)
    run = Run("dive", t, {"u": np.sin(t)}, sha256="ab")
    choice = LogChoice(path="dive.csv", stretches=[LogSegment(start=10.0, end=30.0, role="judge")])
    parts = list(choice.parts(run))
    assert [role for role, _ in parts] == ["train", "judge", "train"]
    assert np.array_equal(np.concatenate([part.t for _, part in parts]), t)
    assert {part.origin for _, part in parts} == {"dive"}  # what differs between dives is the same in them
    assert len({part.name for _, part in parts}) == 3


def test_a_whole_log_stays_as_it_is() -> None:
    run = Run("dive", np.arange(5.0), {})
    assert [part is run for _, part in LogChoice(path="dive.csv").parts(run)] == [True]


def test_a_session_goes_on_where_it_was(tmp_path: Path) -> None:
    place = Workspace.open(tmp_path / "kept", session_of(tmp_path))
    place.session.logs[0].stretches.append(LogSegment(start=1.0, end=2.0, role="out"))
    place.session.steps.append(ModelStep(what="refitted", file="model-1.toml", errors={"force": 2.0}))
    place.save()
    again = Workspace.open(tmp_path / "kept", session_of(tmp_path))
    assert again.session == place.session


def test_a_new_log_joins_a_session(tmp_path: Path) -> None:
    Workspace.open(tmp_path / "kept", session_of(tmp_path))
    wanted = session_of(tmp_path)
    wanted.logs.append(LogChoice(path=str(DEMO / "train_2.csv.gz")))
    again = Workspace.open(tmp_path / "kept", wanted)
    assert [Path(log.path).name[:7] for log in again.session.logs] == ["train_1", "holdout", "train_2"]


def test_a_session_about_another_vehicle_is_refused(tmp_path: Path) -> None:
    Workspace.open(tmp_path / "kept", session_of(tmp_path))
    other = session_of(tmp_path).model_copy(update={"vehicle": "bluerov2"})
    with pytest.raises(UndertowError, match=r"is about vehicle .* not 'bluerov2': name another folder"):
        Workspace.open(tmp_path / "kept", other)


@pytest.mark.parametrize("text", ["{", '{"vehicle": 3}', '{"schema": "undertow/workbench/9"}', "[]"])
def test_a_damaged_session_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    place = Workspace.open(tmp_path / "kept", session_of(tmp_path))
    (place.folder / "session.json").write_text(text)
    with pytest.raises(UndertowError) as refusal:
        Workspace.open(tmp_path / "kept", session_of(tmp_path))
    assert "session.json" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_results_belong_to_a_model_and_a_choice(tmp_path: Path) -> None:
    place = Workspace.open(tmp_path / "kept", session_of(tmp_path))
    place.keep("compare", place.key, {"headline": "fails"})
    assert place.last_result("compare") == ({"headline": "fails"}, True)
    place.session.logs[0].role = "out"
    assert place.last_result("compare") == ({"headline": "fails"}, False)
    place.session.logs[0].role = "train"
    assert place.last_result("compare") == ({"headline": "fails"}, True)


def test_results_belong_to_what_the_mapping_file_says(tmp_path: Path) -> None:
    given = tmp_path / "log.toml"
    given.write_text('schema = "undertow/mapping/1"\n')
    place = Workspace.open(tmp_path / "kept", session_of(tmp_path).model_copy(update={"mapping": str(given)}))
    place.keep("compare", place.key, {"headline": "fails"})
    given.write_text('schema = "undertow/mapping/1"\n[frames]\nbody = "FLU"\n')
    assert place.last_result("compare") == ({"headline": "fails"}, False)


def test_results_belong_to_what_the_users_effects_say(tmp_path: Path) -> None:
    """A file with another force makes results old; one that is new leaves those of the present model."""
    effect = tmp_path / "own.py"
    effect.write_text("# one force\n")
    place = Workspace.open(tmp_path / "kept", session_of(tmp_path))
    place.session.effects.append(str(effect))
    place.keep("compare", place.key, {"headline": "found"})
    place.take_effect(str(DEMO / "vehicle.toml"))  # any file: it is not run here
    assert place.last_result("compare") == ({"headline": "found"}, True)
    effect.write_text("# another force\n")
    assert place.last_result("compare") == ({"headline": "found"}, False)


def test_remedies_go_into_a_mapping_file_of_the_session(tmp_path: Path) -> None:
    given = tmp_path / "log.toml"
    text = 'schema = "undertow/mapping/1"\n# by hand\n[columns]\nspeed = "u"\n'
    given.write_text(text)
    wanted = session_of(tmp_path).model_copy(update={"mapping": str(given)})
    place = Workspace.open(tmp_path / "kept", wanted)
    degrees = '[columns]\npsi = { channel = "psi", unit = "deg" }'
    place.session.remedies += [Remedy(id="a", lines=degrees), Remedy(id="b", lines='[frames]\nbody = "FLU"')]
    place.write_mapping()
    assert given.read_text() == text
    assert "# by hand" in (place.folder / "mapping.toml").read_text()
    now, before = place.mapping(), place.mapping(mended=False)
    assert now is not None
    assert before is not None
    assert (now.columns["psi"].unit, now.frames.body) == ("deg", "FLU")
    assert (before.columns["psi"].unit, before.frames.body) == ("deg", "FRD")


def test_runs_of_one_file_are_chosen_one_by_one(tmp_path: Path) -> None:
    session = Session(
        vehicle="mini-auv", logs=[LogChoice(path="dive.bin", role="judge"), LogChoice(path="b.csv")]
    )
    t = np.arange(3.0)
    runs = [Run("dive-1", t, {}, source="dive.bin"), Run("dive-2", t, {}, source="dive.bin")]
    runs.append(Run("b", t, {}, source="b.csv"))
    session.logs = session.chosen(runs)
    session.logs[1].role = "out"
    assert [(c.path, c.part, c.role) for c in session.chosen(runs)] == [
        ("dive.bin", 0, "judge"), ("dive.bin", 1, "out"), ("b.csv", 0, "train"),
    ]  # fmt: skip
    assert session.paths == [Path("dive.bin"), Path("b.csv")]
    assert Workspace(tmp_path, session).in_pieces  # a command line takes the whole file


def test_what_a_format_means_is_written_down_before_it_is_mended(tmp_path: Path) -> None:
    place = Workspace.open(tmp_path / "kept", session_of(tmp_path))
    used = LogMapping.model_validate({"columns": {"ATT.Yaw": {"channel": "psi"}}, "frames": {"body": "FLU"}})
    place.state_mapping(used)
    place.session.remedies.append(
        Remedy(id="a", lines='[columns]\n"ATT.Yaw" = { channel = "psi", unit = "deg" }')
    )
    place.write_mapping()
    now = place.mapping()
    assert now is not None
    assert (now.columns["ATT.Yaw"].unit, now.frames.body) == ("deg", "FLU")
    assert place.mapping(mended=False) == used


def test_the_lines_of_a_finding_are_read_back_as_changes() -> None:
    edits = (
        Edit("", "missing_commands", "hold"),
        Edit("columns", "heading deg", {"channel": "psi", "unit": "deg", "scale": -1.0}),
        Edit("time", "every", 5),
        Edit("water", "velocity", [0.1, -0.2, 0.0]),
    )
    assert read_edits(as_toml(edits)) == edits
