"""Pictures of closed loops: what is a band and what is a line."""

from __future__ import annotations

import numpy as np

from undertow.control.closed_loop.pictures import band

T = np.linspace(0, 100, 20_001)


def test_a_switching_command_is_the_band_that_it_fills() -> None:
    switching = np.where(T > 50, 0.5 + 0.1 * np.sign(np.sin(2 * np.pi * 20 * T + 0.3)), 1.0)
    edges = band(T, switching)
    assert edges is not None
    times, mean, low, high = edges
    late, early = times > 52, times < 48
    np.testing.assert_allclose(low[late], 0.4)
    np.testing.assert_allclose(high[late], 0.6)
    np.testing.assert_allclose(mean[late], 0.5, atol=0.02)
    np.testing.assert_array_equal(low[early], 1.0)
    np.testing.assert_array_equal(high[early], 1.0)


def test_slow_waves_and_small_noise_are_lines() -> None:
    assert band(T, np.sin(T)) is None
    noise = 0.001 * np.random.default_rng(0).normal(size=T.size)
    assert band(T, np.exp(-T / 20) + noise) is None
    assert band(T[:100], np.sign(np.sin(50 * T[:100]))) is None  # so few rows are drawn as they are
