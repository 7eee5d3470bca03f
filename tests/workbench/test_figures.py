"""Pictures: what is left of a long log, and names out of files in them."""

from __future__ import annotations

import json
from base64 import b64decode

import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser

from undertow.identification.logs.run import Run
from undertow.identification.report.pictures import decimated
from undertow.model.catalogue import catalogue
from undertow.model.describe import describe
from undertow.workbench.figures import SETTINGS, channels, typeset, waterfall


def test_a_million_samples_keep_every_peak_in_two_points_a_pixel() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(1_000_000) / 100.0
    y = rng.normal(size=len(t))
    y[[123_456, 777_777]] = 40.0, -50.0
    short, values = decimated(t, y, SETTINGS.pixels)
    assert len(short) <= 2 * SETTINGS.pixels
    assert (values.max(), values.min()) == (40.0, -50.0)
    assert short[values.argmax()] == t[123_456]
    assert short[values.argmin()] == t[777_777]
    assert np.all(np.diff(short) >= 0)


def test_each_pixel_keeps_its_own_range() -> None:
    t = np.arange(10_000.0)
    y = np.where(t % 2 == 0, t, -t)
    short, values = decimated(t, y, 100)
    for k in range(100):
        own, drawn = y[100 * k : 100 * (k + 1)], values[2 * k : 2 * k + 2]
        assert {own.min(), own.max()} == set(drawn)
    assert np.array_equal(values, y[short.astype(int)])


def test_gaps_stay_gaps_and_short_series_stay_whole() -> None:
    t, y = np.arange(1000.0), np.ones(1000)
    y[300:500] = np.nan
    assert decimated(t, y, 500)[0] is t
    short, values = decimated(t, y, 50)
    gap = (short >= 300) & (short < 500)
    assert np.isnan(values[gap]).all()
    assert np.isfinite(values[~gap]).all()


def test_a_zoomed_stretch_has_its_own_samples() -> None:
    t = np.arange(100_000) / 100.0
    run = Run("dive", t, {"u": np.sin(t)})
    whole = channels(run, ["u"], {})["data"][0]["x"]
    shown_path = channels(run, ["u"], {}, window=(500.0, 502.0))["data"][0]["x"]
    assert np.median(np.diff(whole)) > 0.1
    assert np.allclose(np.diff(shown_path), 0.01)
    assert shown_path[0] <= 500.0
    assert shown_path[-1] >= 502.0


def test_all_channels_share_one_time_axis() -> None:
    t = np.arange(10.0)
    figure = channels(Run("dive", t, {"u": t, "r": t, "f1": t}), ["u", "r", "f1"], {"f1": "N"})
    assert {trace.get("xaxis", "x") for trace in figure["data"]} == {"x"}
    titles = [figure["layout"][axis]["title"]["text"] for axis in ("yaxis", "yaxis2", "yaxis3")]
    assert titles == ["u (m/s)", "r (rad/s)", "f1 (N)"]


@pytest.mark.parametrize("name", ["<script>alert(1)</script>", '<img src=x onerror="alert(1)">', "a<b>&"])
def test_names_out_of_files_are_no_tags(name: str) -> None:
    t = np.arange(10.0)
    drawn = json.dumps(
        [channels(Run("dive", t, {name: t}), [name], {name: name}), waterfall([(name, 1.0)], "", floor=None)]
    )
    assert "<script" not in drawn
    assert "<img" not in drawn


@pytest.mark.slow
def test_all_equations_of_the_catalogue_can_be_typeset() -> None:
    parser = MathTextParser("path")
    for effect in catalogue().values():
        for equation in describe(effect).equations:
            parser.parse(f"${equation.latex}$")


def test_an_equation_is_a_picture_in_the_page_and_stays_text_where_it_cannot_be() -> None:
    address = typeset(describe(catalogue()["quadratic_damping"]).equations[0].latex)
    assert address is not None
    kind, _, content = address.partition(",")
    assert kind == "data:image/svg+xml;base64"
    assert b"<svg" in b64decode(content)
    assert typeset(r"\frac{a") is None
