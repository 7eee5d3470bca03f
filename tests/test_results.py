"""The table of results: fast cases once more, and that the page in docs tells of every case."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.results.hidden import CASES, HEAD, CaseResult, run_case
from benchmarks.results.summary import EMPTY, speed_of, summary_of, with_summary
from benchmarks.results.text import number, percent, table
from benchmarks.speed.goals import GOALS
from benchmarks.speed.history import by_processor, runs
from undertow.cli.main import commands

pytestmark = pytest.mark.docs

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data" / "hidden-effects"
PAGE = ROOT / "docs" / "results.md"

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"the hidden-effect cases are not there ({DATA})")


@pytest.fixture(scope="module")
def page() -> str:
    return PAGE.read_text(encoding="utf-8")


@needs_data
@pytest.mark.parametrize(("case", "effect"), [("auv-current", "ocean_current"), ("usv-lift", "lift")])
def test_a_hidden_effect_comes_first_and_explains_the_logs(case: str, effect: str) -> None:
    found = run_case(DATA, case)
    assert found.truth == (effect,)
    assert found.ranks == [1]
    assert found.diagnosis.effects == [effect]
    assert found.judged == "right"
    before, after = found.diagnosis.steps
    assert before.error > 5
    # What simulates best leaves a little more under the test functions than what was fitted to them.
    assert after.error < 1.25
    assert after.simulation is not None
    assert after.simulation < 1.05
    assert before.prediction is not None
    assert after.prediction is not None
    assert after.prediction < 0.6 * before.prediction


@needs_data
def test_where_nothing_is_hidden_nothing_is_found() -> None:
    found = run_case(DATA, "auv-null")
    assert found.diagnosis.verdict == "adequate"
    assert found.diagnosis.effects == []
    assert found.judged == "right"
    assert found.diagnosis.steps[0].error < 1.15


def test_the_page_has_every_case(page: str) -> None:
    rows = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| ")]
    assert [case for case in CASES if case not in rows] == []


def test_the_rows_of_the_page_are_judged_by_their_verdicts(page: str) -> None:
    cells = [[c.strip() for c in line.split("|")[1:-1]] for line in page.splitlines()]
    rows = {c[0]: c for c in cells if len(c) == len(HEAD) and c[0] in CASES}
    judged = [row[4] for row in rows.values()]
    assert f"{len(judged) - judged.count('wrong')} of {len(CASES)} verdicts are right." in page
    for name, row in rows.items():
        hidden, verdict, named, grade = row[1:5]
        if name.endswith("null"):
            assert (verdict == "adequate") == (grade == "right"), name
        elif grade == "right":
            assert named in (hidden, "–"), name
        *_, ahead, _, _ = row
        assert "→" not in ahead or all(b < a for a, b in before_and_after(ahead)), name


def before_and_after(cell: str) -> list[tuple[float, ...]]:
    """Pairs of per cents in "29% / 30% → 6% / 5%", also with the second half in brackets."""
    halves = [
        [float(x.strip(" ()%")) for x in half.split("/")] for half in cell.replace("(→", "→").split("→")
    ]
    return list(zip(*halves, strict=True))


@needs_data
def test_every_case_of_the_data_is_in_the_table() -> None:
    # A case with a vehicle file of its own (rov-no-righting) asks something else than what is hidden.
    cases = {p.name for p in DATA.iterdir() if p.is_dir() and not (p / "vehicle.toml").exists()}
    assert cases == set(CASES)


def test_what_counts_as_right(monkeypatch: pytest.MonkeyPatch) -> None:
    class Diagnosis:
        verdict = "unexplained"
        effects: tuple[str, ...] = ()
        indistinguishable: tuple[object, ...] = ()

    def judged(kind: str, *truth: str) -> str:
        return CaseResult("case", kind, truth, Diagnosis()).judged  # type: ignore[arg-type]

    assert judged("alien", "drag that grows") == "right"
    assert judged("library", "an effect that no catalogue has") == "right"
    assert judged("library", "lift") == "wrong"
    assert judged("null") == "wrong"
    monkeypatch.setattr(Diagnosis, "verdict", "adequate")
    assert judged("null") == "right"
    assert judged("alien", "drag that grows") == "wrong"


def test_numbers_and_tables() -> None:
    assert [number(v) for v in (1.0, 0.01234, 123.4, 1e-6, None)] == ["1", "0.0123", "123", "0.000001", "–"]
    assert [percent(v) for v in (0.0123, 0.456, None)] == ["1.2%", "46%", "–"]
    assert table(("a", "b"), [("x|y", "1")]) == "| a | b |\n| --- | ---: |\n| x\\|y | 1 |\n"


def test_the_measured_goals_stand_in_the_page_and_stay_when_the_rest_is_made_anew() -> None:
    old = f"# Results\n\n{EMPTY}\n## Simulated logs\n\nrows\n"
    new = with_summary(old, "| strong | 9 of 9 |\n")
    assert summary_of(old) == f"{EMPTY}\n"
    assert "| strong | 9 of 9 |" in summary_of(new)
    assert "rows" not in summary_of(new)
    assert new.startswith("# Results\n")
    assert new.endswith("\n## Simulated logs\n\nrows\n")
    assert with_summary(new, "| strong | 8 of 9 |\n") == new.replace("9 of 9", "8 of 9")
    assert summary_of("# Results\n") == EMPTY
    with pytest.raises(ValueError, match="has no part"):
        with_summary("# Results\n", "")


# --- speed ------------------------------------------------------------------------------------


def test_every_goal_of_speed_is_what_a_command_does() -> None:
    for goal in GOALS:
        assert set(goal.commands.split(", ")) <= set(commands()), goal.what


def test_the_page_names_processors_and_keeps_what_was_measured_on_each(page: str) -> None:
    part = speed_of(page)
    found = by_processor(runs(part, [], "Abacus"))
    assert next(iter(found)) == "Abacus"
    assert set(found["Abacus"]) == {"–"}
    assert {"AMD EPYC", "Intel(R) Xeon(R) Processor"} <= set(found)
    evaluation = next(k for k, goal in enumerate(GOALS) if goal.what.startswith("one evaluation"))
    for processor in ("AMD EPYC", "Intel(R) Xeon(R) Processor"):
        assert f"### {processor}, " in part
        assert f" {found[processor][evaluation]} |" in part.partition("### ")[0]
        assert float(found[processor][evaluation].removesuffix(" ×")) >= 1
