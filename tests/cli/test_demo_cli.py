"""`undertow demo`: what it writes, and that it claims no more than the diagnosis does."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from undertow.cli.main import main
from undertow.demo import DATA
from undertow.model.loading import load_vehicle

# `make demo` runs the same; both are in CONTRIBUTING.
pytestmark = pytest.mark.slow

AUV = ("diagnosis.json", "error-map.png", "falling-error.png", "measured-vs-simulated.png")
WRITTEN = {
    "index.html",
    *(f"auv/{name}" for name in (*AUV, "report.html", "residual-force.png", "vehicle.toml")),
    *(
        f"hull/{way}.{kind}"
        for way in ("step-to-multistep", "multistep-to-step")
        for kind in ("html", "json")
    ),
    *(f"hull/{name}.png" for name in ("effects", "step", "multistep")),
    "tank/vehicle.toml",
}
FIRST, SECOND, THIRD = "1. An AUV", "2. A box hull", "3. A hull in"


@dataclass(frozen=True)
class Reported:
    """A demo that ran: its folder, its words with single spaces, and the folder that it was started in."""

    folder: Path
    words: str
    here: Path

    def read(self, name: str) -> Any:
        return json.loads((self.folder / name).read_text(encoding="utf-8"))

    def hull(self) -> str:
        return self.words[self.words.index(SECOND) : self.words.index(THIRD)]


@pytest.fixture(scope="module", params=["0", "1"], ids=["compiler", "no compiler"])
def reported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Reported:
    """In a folder that has nothing to do with the repository."""
    here = tmp_path_factory.mktemp("elsewhere")
    folder = here / "deep" / "story"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UNDERTOW_NO_COMPILER", request.param)
        patch.chdir(here)
        words = _run(folder)
    return Reported(folder, words, here)


def _run(folder: Path) -> str:
    import contextlib
    import io

    stream = io.StringIO()
    with contextlib.redirect_stdout(stream):
        assert main(["demo", "--out", str(folder)]) == 0
    return " ".join(stream.getvalue().split())


def test_all_files_are_written_and_nothing_else(reported: Reported) -> None:
    files = {str(p.relative_to(reported.folder)) for p in reported.folder.rglob("*") if p.is_file()}
    extra = {n for n in files - WRITTEN if not re.fullmatch(r"hull/\S+-to-\S+\.toml", n)}
    assert files >= WRITTEN
    assert not extra
    assert [p.name for p in reported.here.iterdir()] == ["deep"], "only the folder that was asked for"
    for name in WRITTEN:
        assert f"{reported.folder / name}".replace(" ", "") in reported.words.replace(" ", "")


def test_pictures_are_pictures(reported: Reported) -> None:
    for path in reported.folder.rglob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size > 10_000


def test_the_page_needs_nothing_but_its_folder(reported: Reported) -> None:
    page = (reported.folder / "index.html").read_text(encoding="utf-8")
    names = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert WRITTEN - {"index.html"} <= set(names)
    assert all((reported.folder / name).is_file() for name in names)


def test_the_current_is_named_with_its_values(reported: Reported) -> None:
    truth = json.loads((DATA / "auv" / "truth.json").read_text(encoding="utf-8"))["values"]["ocean_current"]
    diagnosis = reported.read("auv/diagnosis.json")
    assert diagnosis["verdict"] == "missing_effect"
    assert diagnosis["effects"] == ["ocean_current"]
    found = {p["name"]: p for p in diagnosis["parameters"]}
    for name, value in truth.items():
        off = abs(found[name]["value"] - value)
        assert off < max(5 * found[name]["standard_error"], 0.02 * abs(value)), name
        assert f"{name} = {value:.4f}" in reported.words, "the truth is told for comparison"


def test_the_error_falls_on_the_run_that_was_kept_aside(reported: Reported) -> None:
    first, *_, last = reported.read("auv/diagnosis.json")["steps"]
    assert last["error"] < 0.3 * first["error"]
    assert last["error"] < 1.2, "down to sensor noise"
    assert last["prediction"] < 0.3 * first["prediction"]
    row = re.search(
        r"model as given │ (\S+) .*? refitted │ (\S+) .*? with ocean_current │ (\S+) ", reported.words
    )
    assert row
    given, refitted, found = map(float, row.groups())
    assert found < 0.3 * refitted < 0.3 * given
    assert refitted == pytest.approx(first["error"], rel=0.005), "one number for the refitted model"


def test_the_new_vehicle_file_has_the_current(reported: Reported) -> None:
    text = (reported.folder / "auv" / "vehicle.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    assert set(table["effects"]["ocean_current"]) == {"V_N", "V_E"}
    assert table["history"][0]["added"] == ["ocean_current"]
    before = tomllib.loads((DATA / "auv" / "vehicle.toml").read_text(encoding="utf-8"))
    assert "ocean_current" not in before["effects"], "the shipped file stays as it is"


@pytest.mark.parametrize("way", ["step-to-multistep", "multistep-to-step"])
def test_the_hull_is_not_explained_beyond_its_diagnosis(reported: Reported, way: str) -> None:
    diagnosis = reported.read(f"hull/{way}.json")
    assert diagnosis["headline"] in reported.hull(), "the verdict is told word for word"
    named = diagnosis["effects"]
    assert (reported.folder / f"hull/{way}.toml").exists() == bool(named)
    # A current that the tank does not have would do the same to one hull on one heading.
    assert diagnosis["verdict"] in ("missing_effect", "indistinguishable") or not named
    assert set(named) <= {"radiation_memory"}, "the wake has a memory, and nothing else is missing by name"
    fit, judged = way.split("-to-")
    roles = {r["role"]: r["name"] for r in diagnosis["runs"]}
    assert roles == {"train": f"surge_{fit}_coarse", "holdout": f"surge_{judged}_coarse"}


def test_the_hull_fails_where_the_flow_has_a_memory(reported: Reported) -> None:
    """Start-up, coasting and reversal; a few percent of the push (6 N) are far more than there is noise."""
    rows = {
        name: [float(v) for v in re.findall(r"([\d.]+) N", cells)]
        for name, cells in re.findall(r"│ (start-up|coasting|reversal)[^│]*│([^│]*│[^│]*)│", reported.hull())
    }
    assert set(rows) == {"start-up", "coasting", "reversal"}
    assert all(min(values) > 0.1 and max(values) > 0.4 for values in rows.values()), rows


def test_fluid_memory_lowers_the_error_both_ways_round(reported: Reported) -> None:
    rows = {
        n: (float(a), float(b))
        for n, a, b in re.findall(r"│ ([\w ]+?) │ ([\d.]+)% │ ([\d.]+)% │", reported.hull())
    }
    plain, memory = rows["inertia and drag alone"], rows["radiation_memory"]
    assert all(m < 0.9 * p for m, p in zip(memory, plain, strict=True))
    assert min(m / p for m, p in zip(memory, plain, strict=True)) < 0.5
    masses = re.search(r"give ([\d.]+) and ([\d.]+) kg .*? with it ([\d.]+) and ([\d.]+) kg", reported.hull())
    assert masses
    a, b, c, d = map(float, masses.groups())
    potential = 20.6
    assert min(a, b) > potential + 5.0, "added mass that absorbs the wake"
    assert (c, d) == pytest.approx((potential, potential), abs=5.0)


def test_the_tank_says_what_the_panels_say(reported: Reported) -> None:
    values = load_vehicle(reported.folder / "tank" / "vehicle.toml").values
    for way in ("forward", "backward"):
        found = values[f"X_udot_{way}"].value
        assert found == pytest.approx(-0.6404, rel=0.05)  # 1600 panels, docs/story.md
        assert f"{-found:.4g}" in reported.words
