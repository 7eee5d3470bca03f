"""The worked examples: vehicles and mappings work on logs of the same columns, pages say what was found.

The data sets themselves are not part of the project; the tests that need one skip where it is not there.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.examples import tables
from benchmarks.examples.__main__ import EXAMPLES, page
from benchmarks.examples.cse1 import CURVED
from benchmarks.examples.kvlcc2 import BEST, period, swings
from benchmarks.examples.sf30k import lever_arm
from benchmarks.examples.variants import variant, vehicle_of
from benchmarks.results.text import errors, within_runs
from undertow.identification.comparison import compare
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

pytestmark = pytest.mark.docs

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "examples"
DATA = ROOT.parent / "shared" / "data"
FILES = {
    "cse1": ["vehicle.toml"],
    "sf30k": ["vehicle.toml", "vehicle-4dof.toml"],
    "kvlcc2": ["vehicle.toml"],
}
# A page that takes an hour to make (the model ship over all its runs) may be missing from a version.
WRITTEN = [name for name in EXAMPLES if (PAGES / f"{name}.md").is_file()]
VEHICLES = [(folder, file) for folder, files in FILES.items() for file in files]


def test_there_are_pages() -> None:
    assert list(EXAMPLES) == WRITTEN


# --- vehicles and mappings --------------------------------------------------------------------
def table(columns: dict[str, np.ndarray]) -> str:
    """Columns as CSV."""
    lines = [",".join(columns)]
    rows = np.column_stack(list(columns.values()))
    return "\n".join([*lines, *(",".join(f"{x:.6f}" for x in row) for row in rows)]) + "\n"


def model_ship() -> dict[str, np.ndarray]:
    t = np.arange(0.0, 40.0, 0.05)
    pose = {"x_m": 0.3 * np.sin(0.2 * t), "y_m": 0.1 * np.sin(0.3 * t), "psi_rad": 0.3 * np.sin(0.25 * t)}
    rest = {n: np.zeros(len(t)) for n in ("z_m", "phi_rad", "theta_rad")}
    commands = {f"u{k}": 0.5 * np.sin(0.1 * k * t + k) for k in range(1, 6)}
    return {"t_s": t, **pose, **rest, **commands}


def rov(turning: float = 0.2) -> dict[str, np.ndarray]:
    """A vehicle that turns and moves slowly; its Doppler log, off the origin, reports once a second."""
    t = np.arange(0.0, 60.0, 1 / 6)
    rng = np.random.default_rng(3)
    r = turning * np.sin(0.3 * t)
    psi = np.cumsum(r) / 6
    u, v = 0.1 + 0.05 * np.sin(0.2 * t), 0.03 * np.cos(0.15 * t)
    north = np.cumsum(u * np.cos(psi) - v * np.sin(psi)) / 6
    east = np.cumsum(u * np.sin(psi) + v * np.cos(psi)) / 6
    read = {"u_meas_mps": u + 0.56 * r, "v_meas_mps": v + 0.54 * r, "w_meas_mps": 0.02 * np.sin(t)}
    new = np.isclose(t % 1.0, 0.0, atol=1e-6) | np.isclose(t % 1.0, 1.0, atol=1e-6)
    held = np.maximum.accumulate(np.where(new, np.arange(len(t)), 0))
    columns = {
        "t_s": t,
        "N_meas_m": north[held],
        "E_meas_m": east[held],
        "D_meas_m": 60.0 + 0.1 * np.sin(0.2 * t),
    }
    columns |= {n: 0.01 * np.sin(0.4 * t) for n in ("phi_meas_rad", "theta_meas_rad")}
    columns |= {
        "psi_meas_rad": psi,
        "p_meas_radps": 0.004 * np.cos(0.4 * t),
        "q_meas_radps": 0.004 * np.cos(0.4 * t),
    }
    columns |= {
        "r_meas_radps": r,
        **{n: x[held] + rng.normal(0, 0.003, len(t))[held] for n, x in read.items()},
    }
    rpm = ("rpm_lateral", "rpm_vertical", "rpm_ch3_portlike", "rpm_ch4_stbdlike")
    columns |= {n: 400 * np.sin(0.2 * t + k) for k, n in enumerate(rpm)}
    return {**columns, "dvl_new": new.astype(float), "usbl_new": new.astype(float)}


def rolling_ship() -> dict[str, np.ndarray]:
    t = np.arange(0.0, 30.0, 0.01)
    phi = 0.15 * np.exp(-0.01 * t) * np.cos(2 * np.pi * t / 2.54)
    rest = {n: np.zeros(len(t)) for n in ("x", "y", "z", "theta", "psi")}
    return {"time": t, "phi": phi + np.random.default_rng(1).normal(0, 1e-4, len(t)), **rest}


LOGS = {"cse1": model_ship, "sf30k": rov, "kvlcc2": rolling_ship}


def read(folder: str, path: Path, vehicle: Vehicle) -> Run:
    run = read_log(path, read_mapping(ROOT / "examples" / folder / "log.toml"), vehicle.command_names)
    return velocities_from_pose(run, vehicle.degrees_of_freedom)


@pytest.mark.parametrize(("folder", "file"), VEHICLES)
def test_compare_runs_on_a_log_of_the_same_columns(folder: str, file: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(f"examples/{folder}/{file}")
    path = tmp_path / "log.csv"
    path.write_text(table(LOGS[folder]()), encoding="utf-8")
    run = read(folder, path, vehicle)
    assert not [note for note in run.notes if note.startswith("columns not used")]
    result = compare(vehicle, [run], compiled=False).result
    assert [d.degree_of_freedom for d in result.dofs] == list(vehicle.degrees_of_freedom)
    assert all(np.isfinite(d.residual_rms) for d in result.dofs)
    assert result.prediction_error is not None


def test_the_published_model_of_the_rov_is_read_with_its_signs() -> None:
    six, four = (vehicle_of(f"examples/sf30k/{file}") for file in FILES["sf30k"])
    values = {
        s: six.value_of(str(s)).value for s in six.mass_matrix.free_symbols if str(s) in six.parameter_names
    }
    mass = np.array(six.mass_matrix.xreplace(values), dtype=float)
    np.testing.assert_allclose(mass, mass.T)
    assert mass[0, 0] == pytest.approx(1862.87 + 779.79)
    assert mass[0, 2] == pytest.approx(-103.32)
    assert mass[3, 5] == pytest.approx(33.413 + 21.019)
    assert (np.linalg.eigvalsh(mass) > 0).all()
    shared = [n for n in four.values if not n.startswith("S_")]
    assert [n for n in shared if four.value_of(n) != six.value_of(n)] == []
    # The centre of buoyancy must be above the centre of gravity: it rights the vehicle.
    assert six.value_of("S_z").value == pytest.approx(0.363 * 18504.8)


def test_a_doppler_log_off_the_origin_is_seen_against_position_fixes(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(table(rov(turning=0.4)), encoding="utf-8")
    arm = lever_arm(read("sf30k", path, vehicle_of("examples/sf30k/vehicle-4dof.toml")))
    assert arm["x_s"]["value"] == pytest.approx(0.54, abs=0.1)
    assert arm["y_s"]["value"] == pytest.approx(-0.56, abs=0.1)


# --- the roll decay ---------------------------------------------------------------------------
def test_vertical_sides_shorten_the_period_of_large_swings(tmp_path: Path) -> None:
    sides = {"nonlinear_restoring": {"BM": 0.2}}
    stiff = vehicle_of(variant("examples/kvlcc2/vehicle.toml", sides, tmp_path / "v.toml"))
    plain = vehicle_of("examples/kvlcc2/vehicle.toml")
    inertia = 115.7 + 20.0
    for vehicle in (plain, stiff):
        assert period(vehicle, np.array([1e-3]))[0] == pytest.approx(
            2 * np.pi * np.sqrt(inertia / 821.872), rel=1e-4
        )
    large = np.array([0.15])
    # A pendulum gets slower by amplitude^2 / 16; a cubic stiffness k3 changes it by -3/8 k3/k1 amplitude^2.
    slope = 3 / 8 * (0.5 * 0.2 / 0.08426 - 1 / 6)
    for vehicle, share in ((plain, 1 / 16), (stiff, -slope)):
        change = period(vehicle, large)[0] / period(vehicle, np.array([1e-3]))[0] - 1
        assert change == pytest.approx(share * 0.15**2, rel=0.05)


def test_the_swings_of_a_decay_are_measured() -> None:
    t = np.arange(0.0, 40.0, 0.05)
    run = Run("decay", t, {"phi": 0.1 * np.exp(-0.02 * t) * np.sin(2 * np.pi * t / 2.5)})
    _, height, seconds = swings(run)
    np.testing.assert_allclose(seconds, 2.5, atol=2e-3)
    np.testing.assert_allclose(np.log(height[:-1] / height[1:]), 0.02 * 2.5, atol=0.01)


# --- pages ------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", WRITTEN)
def test_the_page_is_what_its_numbers_and_words_give(name: str) -> None:
    numbers = json.loads((PAGES / "numbers" / f"{name}.json").read_text(encoding="utf-8"))
    assert (PAGES / f"{name}.md").read_text(encoding="utf-8") == page(name, numbers)


@pytest.mark.parametrize("name", WRITTEN)
def test_what_a_page_points_to_is_there(name: str) -> None:
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert any(link.endswith(".png") for link in links)
    local = [link for link in links if not link.startswith("http")]
    assert [link for link in local if not (PAGES / link).resolve().exists()] == []


@pytest.mark.parametrize("name", WRITTEN)
def test_a_page_says_what_is_believed_and_how_it_was_made(name: str) -> None:
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    for title in ("What the data are", "Commands", "What the comparison shows", "What the diagnosis says"):
        assert f"## {title}\n" in text
    belief = text.partition("## What we believe, and what we do not\n")[2]
    assert len(belief.partition("\n## ")[0].split()) > 100
    assert "{{" not in text
    assert "to be written" not in text


def test_the_pages_are_listed_and_lead_to_each_other() -> None:
    index = (PAGES / "README.md").read_text(encoding="utf-8")
    assert [name for name in WRITTEN if f"({name}.md)" not in index] == []


@pytest.mark.parametrize("name", WRITTEN)
def test_every_verdict_is_on_the_page(name: str) -> None:
    numbers = json.loads((PAGES / "numbers" / f"{name}.json").read_text(encoding="utf-8"))
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    for reported in numbers["diagnoses"]:
        assert f"| {reported['title']} | {reported['verdict']} |" in text
        assert reported["headline"] in text
        for step in reported["steps"]:
            assert errors(list(within_runs(step["ahead"]).values())) in text


# --- what an owner can do -----------------------------------------------------------------------
@pytest.mark.parametrize("name", WRITTEN)
def test_a_page_begins_with_what_an_owner_can_do(name: str) -> None:
    title, blank, first, end, *_ = (PAGES / f"{name}.md").read_text(encoding="utf-8").splitlines()
    assert title.startswith("# ")
    assert (blank, end) == ("", "")
    assert first.endswith(".")
    assert ". " not in first
    assert first.split()[0] in ("Add", "Give", "Measure", "Put", "To", "Weigh")
    numbers = json.loads((PAGES / "numbers" / f"{name}.json").read_text(encoding="utf-8"))
    assert SUPPORTED[name](numbers)


Numbers = dict[str, Any]


def memory_lowers_every_error(n: Numbers) -> bool:
    reported = n["diagnoses"][1]
    before, after = (within_runs(reported["steps"][k]["ahead"]) for k in (0, 1))
    return reported["steps"][1]["added"] == ["radiation_memory"] and all(after[h] < before[h] for h in before)


def the_shape_of_the_hull_explains_a_free_run(n: Numbers) -> bool:
    fits = {model: [r["fit"] for r in n["by_hand"] if r["model"] == model] for model in ("linear", BEST)}
    return min(fits[BEST]) > 95 > 85 > max(fits["linear"])


def curve_and_delay_lower_the_error(n: Numbers) -> bool:
    ahead = {(r["way"], r["model"]): r["ahead"] for r in n["by_hand"]}
    ways = [way for way, model in ahead if "joystick" in way and model == "model"]
    return len(ways) == 2 and all(ahead[way, CURVED] < 0.95 * ahead[way, "model"] for way in ways)


def the_published_model_is_worse_than_none(n: Numbers) -> bool:
    return n["compared"]["four"]["prediction_error"] > 1 > 2 * n["by_hand"][-1]["ahead"]


SUPPORTED = {
    "cse1": curve_and_delay_lower_the_error,
    "sf30k": the_published_model_is_worse_than_none,
    "kvlcc2": the_shape_of_the_hull_explains_a_free_run,
    "cfd-surge": memory_lowers_every_error,
}


def test_an_answer_is_put_into_a_cell() -> None:
    answer = {
        "effects": ["attitude_bias", "lift"],
        "helps": ["waves"],
        "indistinguishable": [{"effects": ["attitude_bias", "trim_offset"]}],
        "steps": [{"ahead": {"2 s": 0.5, "8 s": 0.9, "free run": 2.0}}, {"ahead": {"2 s": 0.25, "8 s": 0.3}}],
    }
    assert tables.found(answer) == "attitude_bias (or trim_offset), lift, waves (helps)"
    assert tables.falls(answer) == "8 s ahead from 90% to 30%"


# --- the data, where they are -----------------------------------------------------------------
LOG_OF = {
    "cse1": ("ntnu-cse1/freerun/manual_run1.csv", (20.0, 60.0)),
    "sf30k": ("ntnu-rov-sf30k/sf30k_20150518_1829.csv", (720.0, 800.0)),
    "kvlcc2": ("kvlcc2-rolldecay-sspa/model_test_21337.csv", (25.0, 60.0)),
}


@pytest.mark.parametrize("folder", LOG_OF)
def test_the_real_log_is_read(folder: str) -> None:
    name, window = LOG_OF[folder]
    if not (DATA / name).is_file():
        pytest.skip(f"the data set is not there ({DATA / name})")
    vehicle = vehicle_of(f"examples/{folder}/vehicle.toml")
    mapping = read_mapping(ROOT / "examples" / folder / "log.toml")
    run = read_log(DATA / name, mapping, vehicle.command_names, window=window)
    run = velocities_from_pose(run, vehicle.degrees_of_freedom)
    moving = [n for n in vehicle.velocity_names if np.nanstd(run.channels[n]) > 0]
    assert moving == list(vehicle.velocity_names)


def test_the_tanker_gets_stiffer_as_it_heels() -> None:
    path = DATA / LOG_OF["kvlcc2"][0]
    if not path.is_file():
        pytest.skip(f"the data set is not there ({path})")
    run = read_log(path, read_mapping(ROOT / "examples" / "kvlcc2" / "log.toml"), window=(25.0, 91.0))
    _, height, seconds = swings(run)
    large, small = seconds[height > np.radians(7)], seconds[height < np.radians(5)]
    assert np.mean(large) < np.mean(small) - 0.008
