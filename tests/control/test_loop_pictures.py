"""Pictures of closed loops: what is a band and what is a line, units, and what rests."""

from __future__ import annotations

import numpy as np
import pytest

from tests.control.loops import run as simulated
from undertow.control.closed_loop.pictures import SPAN, band, pictures
from undertow.control.closed_loop.record import CommandRange
from undertow.control.closed_loop.scenario import Scenario
from undertow.control.closed_loop.simulate import ClosedLoop
from undertow.control.gains import load_gains
from undertow.model.loading import load_vehicle

T = np.linspace(0, 100, 20_001)


def of_samples(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...] | None:
    """The band of a command of which every sample is a row."""
    return band(t, values, CommandRange(values, values, np.abs(np.diff(values, prepend=values[0]))))


def test_a_switching_command_is_the_band_that_it_fills() -> None:
    switching = np.where(T > 50, 0.5 + 0.1 * np.sign(np.sin(2 * np.pi * 20 * T + 0.3)), 1.0)
    edges = of_samples(T, switching)
    assert edges is not None
    times, mean, low, high = edges
    late, early = times > 52, times < 48
    np.testing.assert_allclose(low[late], 0.4)
    np.testing.assert_allclose(high[late], 0.6)
    np.testing.assert_allclose(mean[late], 0.5, atol=0.02)
    np.testing.assert_array_equal(low[early], 1.0)
    np.testing.assert_array_equal(high[early], 1.0)


def test_slow_waves_and_small_noise_are_lines() -> None:
    assert of_samples(T, np.sin(T)) is None
    noise = 0.001 * np.random.default_rng(0).normal(size=T.size)
    assert of_samples(T, np.exp(-T / 20) + noise) is None
    assert of_samples(T[:100], np.sign(np.sin(50 * T[:100]))) is None  # so few rows are drawn as they are


def test_chattering_between_the_rows_of_a_run_is_a_band() -> None:
    """Sliding modes switch at every sample; the mean of ten samples shows none of it."""
    loop = ClosedLoop(load_gains("paper-smc", load_vehicle("mini-auv")))
    run = loop.run(Scenario((0, 0, 1), duration=4.0, dt=0.001, log_interval=0.01))
    swing, found = run.command_ranges["f1"], next(c for c in run.result.commands if c.name == "f1")
    assert max(-swing.low.min(), swing.high.max()) == found.peak
    np.testing.assert_allclose(swing.travel.sum() / 4.0, found.variation, rtol=1e-3)
    assert np.ptp(run.commands["f1"][10:]) < 0.2 * np.ptp([swing.low[10:], swing.high[10:]])
    edges = band(run.t, run.commands["f1"], swing)
    assert edges is not None
    assert np.max(edges[3] - edges[2]) > 5.0


def test_rounding_errors_of_what_rests_do_not_look_like_motion() -> None:
    """A move to the north at zero heading: nothing turns, nothing goes east."""
    run = simulated("paper-pd", to=(1.0, 0.0, 0.0), duration=5.0)
    assert 0.0 < np.ptp(run.state["psi"]) < 1e-12
    drawn = pictures([run])
    spans = {name: np.ptp(drawn[name].axes[0].get_ylim()) for name in ("x", "y", "psi")}
    assert spans["x"] == pytest.approx(1.1, rel=0.01)
    assert spans["y"] == pytest.approx(SPAN.metres)
    assert spans["psi"] == pytest.approx(SPAN.degrees)


def test_commands_have_their_units() -> None:
    run = simulated("paper-pd", to=(0.0, 0.0, 1.0), duration=2.0)
    axes = pictures([run])["commands"].axes
    assert [axis.get_ylabel() for axis in axes] == [f"f{i} [N]" for i in (1, 2, 3, 4)]
    largest = max(c.peak for c in run.result.commands)
    assert all(np.ptp(axis.get_ylim()) >= 0.999 * SPAN.command * largest for axis in axes)
