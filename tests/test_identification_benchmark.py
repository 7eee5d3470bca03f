"""The benchmark of estimators: its experiment is the paper's, its bound the known one, its page complete."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.identification import hardships, variables
from benchmarks.identification.cfd import estimates
from benchmarks.identification.hardships import ESTIMATORS, OUTLIERS
from benchmarks.identification.page import BIASES, Beyond, page
from benchmarks.identification.pictures import draw_biases
from benchmarks.identification.profile import EXACT, INTERVAL, JUMPS, logs
from benchmarks.identification.study import METHODS, OUTPUT, study
from benchmarks.identification.towing import towing
from tests.identification.test_least_squares import profile_p

pytestmark = pytest.mark.docs

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared" / "data"
DATA, BASIN = SHARED / "cfd-surge", SHARED / "ntnu-cse1"


def test_profile_p_is_simulated_as_elsewhere() -> None:
    run = profile_p(INTERVAL)
    sampled, held = logs(0.0, 0, mirrored=True)
    for name, channel in run.channels.items():
        np.testing.assert_allclose(sampled.channels[name], -channel, rtol=1e-9, atol=1e-13)
    assert len(held.t) == len(run.t) + len(JUMPS)
    # The held force has the impulse of the profile: 17.8 s of 0.32 N, 3.5 s of -0.48 N, the rest of 0.22 N.
    impulse = np.sum(np.diff(held.t) * held.channels["tau_X"][:-1])
    assert impulse == pytest.approx(-(0.32 * 17.8 - 0.48 * 3.5 + 0.22 * (30.0 - 21.95)))
    assert not held.has("u_dot")


def test_few_draws_give_the_known_bound_and_errors_near_it() -> None:
    levels = study(6, lambda done, words: None)
    # Independent values (shared/PAPER.md) without the three samples at the jumps, % of the truth.
    known = {0.005: (0.10, 4.4, 0.65), 0.02: (0.40, 18, 2.6), 0.05: (0.99, 44, 6.4), 0.10: (1.97, 88, 12.9)}
    for level in levels:
        np.testing.assert_allclose(100 * level.bound / EXACT, known[level.noise], rtol=0.05)
        assert np.all(level.rmse(OUTPUT) < 2.2 * 100 * level.bound / EXACT)
        assert level.best_case()[0] > 2 * level.rmse(OUTPUT)[0]
        assert set(level.estimates) == set(METHODS)
        assert all(found.shape == (6, 3) for found in level.estimates.values())
    text = page(levels, 6, [], "end\n")
    assert text.count("output error ≤ 1.10 × bound") == 4
    assert "case 11, the paper's choice" in text


def test_one_draw_of_everything_beside_profile_p_makes_its_sections(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(variables, "NOISES", (0.05,))
    monkeypatch.setattr(variables, "CURRENTS", (0.2,))
    monkeypatch.setattr(variables, "DURATION", 60.0)
    found = variables.biases(1, lambda done, words: None)
    known = [b for b in found if variables.KNOWN in b.method]
    assert {b.method for b in found if not b.current} == set(variables.METHODS)
    # One minute is enough to see the current, and to see what it does to a model without it.
    assert all(abs(b.mean[0]) < 1 for b in known)
    assert max(abs(b.mean[2]) for b in found if b.current and b not in known) > 30
    # Private: one log in place of the hundreds of the page.
    hard = [hardships._of(OUTLIERS, m, e, [hardships.log(OUTLIERS, 1)]) for m, e in ESTIMATORS.items()]
    off = {h.method: h.rmse[0] for h in hard}
    assert off["output error, Huber"] < off["output error"]
    text = "\n".join(Beyond(1, found, hard).parts())
    assert "| 5% | instrumental variables |" in text
    assert f"| 0.2 m/s | output error, {variables.KNOWN} |" in text
    assert f"| {OUTLIERS} | prediction error |" in text
    draw_biases(found, tmp_path / "biases.png")
    assert (tmp_path / "biases.png").stat().st_size > 10_000


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the CFD runs are not there ({DATA})")
def test_the_box_hull_by_all_methods() -> None:
    found = {(e.log, e.method): e for e in estimates(DATA)}
    assert len(found) == 8
    for e in found.values():
        # No method finds the 81.1 kg of potential theory: the model lacks the memory of the wake.
        assert 85 < e.values[0] < 115, e
        assert e.values[2] >= 0


def test_the_page_in_docs_is_of_this_program() -> None:
    text = (ROOT / "docs" / "identification.md").read_text(encoding="utf-8")
    for noise in ("0.5%", "2%", "5%", "10%"):
        assert f"| {noise} | output error |" in text
    for method in (*variables.METHODS, *ESTIMATORS):
        assert f"| {method} |" in text
    for picture in ("identification-spread.png", BIASES):
        assert (ROOT / "docs" / "images" / picture).is_file()


@pytest.mark.skipif(not BASIN.is_dir(), reason=f"the towing tests are not there ({BASIN})")
def test_towing_gives_the_drag_that_its_providers_fitted_and_no_added_mass() -> None:
    found = towing(BASIN, methods=["weak"])
    assert found.runs == 54
    assert found.mass == "not identifiable"
    means, samples, weak, *free = found.rows
    # README of the data: X = -0.14 u - 3.09 u|u| over the full range.
    np.testing.assert_allclose(means.values, (0.14, 3.09), atol=0.005)
    for other in (samples, weak):
        gap = np.abs(np.subtract(other.values, means.values))
        assert np.all(gap < 3 * np.hypot(other.errors, means.errors))
        np.testing.assert_allclose(other.drag, found.measured, rtol=0.15)
    assert all(np.all(np.abs(f.drag / found.measured - 1) < 1) for f in free)
    text = page([], 1, [], "", None, found)
    assert "not identifiable" in text
    assert "0.137 ± 0.06" in text
    assert "## Towing tests of a model ship" in text
