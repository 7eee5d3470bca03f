"""MISRA C:2012 in exported C, as cppcheck's addon sees it: nothing beyond what docs/export.md lists."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.codegen.test_library import _auv
from tests.control.test_controller_export import table as gain_table
from undertow.codegen.library import Library
from undertow.control.gains import gains_from_table
from undertow.control.guidance.mission import load_mission
from undertow.control.laws import LAWS
from undertow.control.update import library_of
from undertow.model.catalogue import catalogue
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value
from undertow.observer.design import ObserverTable, design

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "export.md"
# cppcheck follows every path of a function; on longer ones it takes many minutes.
LONGEST = 1200  # lines of a source

pytestmark = pytest.mark.skipif(shutil.which("cppcheck") is None, reason="needs cppcheck")


def listed() -> set[str]:
    """Rules whose deviations the page lists."""
    return set(re.findall(r"^\| (\d+\.\d+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE))


def violated(folder: Path) -> set[str]:
    """Rules that the sources of a library violate, with where, by number."""
    found: set[str] = set()
    for source in sorted((folder / "src").glob("*.c")):
        if source.read_text().count("\n") > LONGEST:
            continue
        command = ["cppcheck", "--addon=misra", "--std=c99", "--quiet", "--template={file}:{line} {id}"]
        words = subprocess.run(
            [*command, "-I.", source.name], cwd=source.parent, capture_output=True, text=True
        )
        assert words.returncode == 0, words.stderr
        assert "_real.h:" in words.stderr  # that the addon has run: what all sources include deviates
        found |= set(re.findall(r"\S+ misra-c2012-\S+", words.stderr))
    return found


def hull() -> Library:
    """One degree of freedom, with both filters and late velocities."""
    delay = {"velocity_delay": Value(0.3)}
    vehicle = load_vehicle("box-hull").with_effect(catalogue()["sensor_delay"], delay)
    content = {
        "schema": "undertow/observer/1",
        "sensors": {"x": {"noise": "5 cm"}, "u": {"noise": "1 cm/s", "period": "0.1 s"}},
        "disturbance": {"u": 0.01},
    }
    tables = [{**content, "name": f"gps {kind}", "filter": kind} for kind in ("ekf", "ukf")]
    return library_of(vehicle, [], [design(ObserverTable.model_validate(t), vehicle) for t in tables])


def laws() -> Library:
    vehicle = load_vehicle("mini-auv")
    tables = [gain_table(law, unactuated=["sway"]) for law in LAWS]
    return library_of(vehicle, [gains_from_table(table, vehicle) for table in tables])


def guided() -> Library:
    """Line of sight under a sliding mode."""
    vehicle = load_vehicle("mini-auv")
    gains = gains_from_table(gain_table("sliding-mode-boundary-layer", unactuated=["sway"]), vehicle)
    return library_of(vehicle, [gains], [], load_mission(ROOT / "benchmarks" / "chain" / "four-legs.toml"))


def beyond(found: set[str]) -> set[str]:
    return {violation for violation in found if violation.rpartition("-")[2] not in listed()}


def test_the_rules_that_are_violated_are_those_that_are_listed(tmp_path: Path) -> None:
    found = violated(hull().write(tmp_path).folder)
    assert {violation.rpartition("-")[2] for violation in found} == listed()


@pytest.mark.slow
@pytest.mark.parametrize("library", [_auv, laws, guided])
def test_nor_are_others_in_laws_guidance_and_allocation(
    library: Callable[[], Library], tmp_path: Path
) -> None:
    assert not beyond(violated(library().write(tmp_path).folder))


@pytest.mark.slow
@pytest.mark.parametrize("name", bundled_vehicles())
def test_nor_in_any_bundled_vehicle(name: str, tmp_path: Path) -> None:
    assert not beyond(violated(Library(load_vehicle(name)).write(tmp_path).folder))
