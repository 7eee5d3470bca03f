"""The report: one page that stands alone, names stay text, pictures show the numbers that they are given."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from tests.quick import first_quick
from undertow.cli.identification.diagnose import _content, show  # for what no log here has
from undertow.errors import UndertowError
from undertow.figures import plain, save_png, svg, unit_text, with_unit
from undertow.identification.comparison import Profile, compare
from undertow.identification.diagnose import _with_doctor  # for findings that no log here has
from undertow.identification.diagnosis.result import (
    ChannelNoise,
    Diagnosis,
    DisturbanceLevel,
    Estimate,
    Floors,
    Indistinguishable,
    Predictability,
    Ranked,
    Remaining,
    RunInfo,
    Step,
    Verdict,
    explanations,
)
from undertow.identification.findings import Examination
from undertow.identification.findings import Finding as Found
from undertow.identification.logs.run import Run
from undertow.identification.report.page import (
    parameter_text,
    percent,
    quantity,
    render_report,
    report_data,
    with_error,
)
from undertow.identification.report.pictures import (
    Budget,
    ErrorMap,
    Listing,
    ReportData,
    ResidualCurve,
    RunTraces,
    Trace,
    decimated,
    error_map,
    falling_error,
    force_budget,
    measured_vs_simulated,
    ranking,
    residual_against,
)
from undertow.model.loading import load_vehicle

EVIL = "<script>alert('1')</script>\"&$x_1$\n日本"
SECTIONS = (
    *("verdict", "map", "traces", "residuals", "ranking", "steps"),
    *("sets", "remaining", "parameters", "warnings", "record"),
)
VOID = {"meta", "br", "link", "img", "hr", "input"}


def _estimate(name: str = "X_uabsu", value: float = -5.1234, error: float | None = 0.0123) -> Estimate:
    return Estimate(
        name=name,
        effect="quadratic_damping",
        value=value,
        standard_error=error,
        unit="N/((m/s)^2)",
        about="drag",
    )


def _ranked(effect: str, improvement: float, **more: object) -> Ranked:
    return Ranked(
        effect=effect,
        family="water",
        about=f"about {effect}",
        parameters=[_estimate()],
        error_before=6.25,
        error_after=1.02,
        explained=0.987,
        improvement=improvement,
        interval=(0.9 * improvement - 0.05, 1.1 * improvement + 0.05),
        significant=improvement > 0.1,
    ).model_copy(update=more)


def _diagnosis(
    verdict: Verdict = "missing_effect", name: str = "mini-auv", role: str = "holdout"
) -> Diagnosis:
    run = {"source": f"/logs/{name}.csv", "sha256": "ab" * 32, "samples": 600, "duration": 60.0}
    return Diagnosis(
        undertow="0.1.0",
        vehicle=name,
        degrees_of_freedom=["surge", "yaw"],
        signs="sname",
        runs=[
            RunInfo(name=name, role="train", notes=[f"{name}: 3 outliers dropped"], **run),
            RunInfo(name="second", role=role, notes=[], **run),
        ],
        verdict=verdict,
        headline=f"headline of {name}",
        effects=[name],
        ranking=[_ranked(name, 30.0), _ranked("lift", 0.01)],
        steps=[Step(added=[], error=6.25, prediction=0.31), Step(added=[name], error=1.02)],
        indistinguishable=[Indistinguishable(effects=[name, "lift"], reason=f"reason {name}")],
        warnings=[f"warning {name}"],
        remaining=[
            Remaining(
                degree_of_freedom="surge",
                normalised_error=1.03,
                residual_rms=0.125,
                noise_rms=0.11,
                unit="N",
                note=f"note {name}",
            )
        ],
        parameters=[_estimate("X_u", 4.1234, 0.12).model_copy(update={"prior": 3.9, "about": name})],
        false_alarm_rate=0.01,
        noise={"u": 0.012, name: 0.1},
        floors=Floors(
            sensors=[
                ChannelNoise(channel="u", unit="m/s", sigma=0.012, stated=True),
                ChannelNoise(channel="r", unit="rad/s", sigma=1e-9, stated=False, cut_off=1.23),
            ],
            disturbances=[
                DisturbanceLevel(
                    degree_of_freedom="yaw", unit="N m", rms=0.37, correlation_time=2.6, stated=0.5
                )
            ],
        ),
        seconds=12.34,
    )


def _trace(channel: str = "u", n: int = 4000) -> Trace:
    t = np.arange(n) * 0.05
    measured = np.sin(0.2 * t)
    measured[1000:1200] = np.nan
    return Trace(channel, "m/s", t, measured, 0.8 * np.sin(0.2 * t), np.sin(0.2 * t))


def _data(name: str = "run1", runs: int = 1) -> ReportData:
    map_ = ErrorMap(("surge", name), ("slow", name), np.array([[4.0, np.nan], [2.0, 9.0]]), np.ones((2, 2)))
    centre = np.linspace(-1, 1, 7)

    def profile(dof: str, slope: float) -> Profile:
        error = np.full(7, 0.05)
        return Profile(dof, name, "m/s", centre, slope * centre, error, np.full(7, 9))

    curves = [ResidualCurve("N", profile(dof, 2.0), profile(dof, 0.0)) for dof in ("surge", "yaw")]
    return ReportData(
        before=name,
        after="better",
        headlines=(f"fails in {name}",),
        maps=(map_,),
        runs=tuple(RunTraces(f"{name} {i}", (_trace("u"), _trace(name))) for i in range(runs)),
        residuals=tuple(curves),
        budgets=(Budget("surge", "N", {"thrusters": 3.0, name: 1.0}),),
        fits=Listing(("channel", "fit"), ((name, "71%"),)),
        settings={"a setting": name},
        versions={"numpy": "2.0"},
    )


@cache
def _html() -> str:
    return render_report(_diagnosis(), _data())


class _Page(HTMLParser):
    """What a browser would see: balanced tags, ids, links, text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.attributes: list[tuple[str, str]] = []
        self.svg_text = ""
        self.text = ""
        self.chunks: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.tags.add(tag)
        self.attributes += [(k, v or "") for k, v in attrs]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes += [(k, v or "") for k, v in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        self.chunks.append(data)
        if "svg" in self.open:
            self.svg_text += data

    def values(self, *names: str) -> list[str]:
        return [v for k, v in self.attributes if k in names]


def _words(html: str) -> str:
    return " ".join(" ".join(_Page(html).chunks).split())


# --- the page ---------------------------------------------------------------------------------
@pytest.mark.parametrize("verdict", first_quick(get_args(Verdict), 2))
def test_every_verdict_has_its_page(verdict: Verdict) -> None:
    page = _Page(render_report(_diagnosis(verdict), _data(runs=0)))
    assert not page.open
    ids = page.values("id")
    assert [i for i in ids if i in SECTIONS] == list(SECTIONS)
    assert set(SECTIONS) <= {v.removeprefix("#") for v in page.values("href")}
    assert len(ids) == len(set(ids))
    assert "What this does not show" in page.text
    assert "headline of mini-auv" in page.text


def test_verdicts_are_explained_differently() -> None:
    texts = {
        _words(render_report(_diagnosis(v))).split("Where the model fails")[0] for v in get_args(Verdict)
    }
    assert len(texts) == len(get_args(Verdict))


def test_nothing_is_loaded_from_anywhere() -> None:
    html = _html()
    page = _Page(html)
    assert not page.tags & {"script", "link", "img", "image", "iframe", "object", "embed", "base", "form"}
    assert all(v.startswith("#") for v in page.values("href", "src", "xlink:href", "action", "data"))
    assert not [k for k, _ in page.attributes if k.startswith("on")]
    assert set(re.findall(r"\w+://[^\s\"'<)]*", html)) == {"http://www.w3.org/2000/svg"}
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", html))
    assert "@import" not in html


def test_references_inside_pictures_find_their_target() -> None:
    html = _html()
    ids = set(_Page(html).values("id"))
    wanted = set(re.findall(r"url\(#([^)]+)\)", html)) | set(re.findall(r'href="#([^"]+)"', html))
    assert len(wanted) > len(SECTIONS)
    assert wanted <= ids


def test_names_from_files_stay_text() -> None:
    html = render_report(_diagnosis(name=EVIL), _data(EVIL))
    page = _Page(html)
    assert "script" not in page.tags
    assert "<script" not in html
    assert page.text.count("<script>alert('1')</script>\"&$x_1$") >= 12
    # In pictures as well: axis labels, legends, ticks; a line break becomes a mark, a dollar no formula.
    assert page.svg_text.count("<script>alert('1')</script>\"&$x_1$") >= 4
    assert not page.open


def test_numbers_have_their_units() -> None:
    words = _words(_html())
    for text in (
        "X_u|u| = (−5.123 ± 0.012) N/(m/s)²",
        "(4.12 ± 0.12) N/(m/s)²",
        "6.25 → 1.02",
        "error before → after, multiple of the noise",
        "6.25 × noise",
        "31%",
        "0.125 N",
        "600 samples",
        "60 s",
        "u: 0.012 m/s",
        "at most 1%",
        "98.7%",
        "filtered above 1.2 Hz before it was logged",
        "0.37 N m correlated over 2.6 s; 0.5 N m stated",
    ):
        assert text in words, text


def test_the_record_tells_files_hashes_roles_notes_settings_and_versions() -> None:
    words = _words(render_report(_diagnosis(role="blocks"), _data()))
    roles = "fitting, with blocks for validation"
    for text in ("/logs/mini-auv.csv", "ab" * 32, roles, "3 outliers dropped"):
        assert text in words
    for text in ("a setting run1", "numpy 2.0", "undertow 0.1.0", "12.3 s"):
        assert text in words
    assert "blocks of the same runs" in words.split("Where the model fails")[0]


def test_without_data_every_section_says_so() -> None:
    bare = _diagnosis("adequate").model_copy(
        update={
            n: [] for n in ("ranking", "steps", "indistinguishable", "warnings", "remaining", "parameters")
        }
    )
    page = _Page(render_report(bare, ReportData(maps=(ErrorMap(("surge",), (), np.zeros((1, 0))),))))
    assert not page.open
    assert "svg" not in page.tags
    for text in ("No error map", "No run was simulated", "No candidate was tried", "No parameter was fitted"):
        assert text in page.text


def test_one_model_alone_has_one_map_and_one_simulation() -> None:
    map_ = ErrorMap(("surge",), ("slow",), np.array([[1.1]]))
    trace = Trace("u", "m/s", np.arange(5.0), np.arange(5.0), np.arange(5.0))
    alone = ReportData(before="only model", maps=(map_,), runs=(RunTraces("run", (trace,)),))
    assert "better" in _Page(_html()).svg_text
    page = _Page(render_report(_diagnosis("adequate"), alone))
    assert page.svg_text.count("only model") == 2
    assert alone.after not in page.svg_text


@pytest.mark.slow
def test_a_page_of_many_long_runs_stays_small() -> None:
    names = ("u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi")
    rng = np.random.default_rng(1)
    noisy = [Trace(n, "m/s", np.arange(2e4), *rng.standard_normal((3, 20_000))) for n in names]
    data = ReportData(runs=tuple(RunTraces(f"run{i}", tuple(noisy)) for i in range(5)))
    html = render_report(_diagnosis(), data)
    assert len(html.encode()) < 3_000_000
    assert "Not drawn: run3, run4." in html


def test_a_comparison_becomes_a_report() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    u = 0.3 * np.sin(0.3 * t) + 0.001 * np.random.default_rng(2).standard_normal(len(t))
    force = 300.0 * np.abs(u) * u + 81.0 * 0.09 * np.cos(0.3 * t)  # nine times the drag of the model
    channels = {"x": np.cumsum(u) * 0.05, "u": u, "tau_X": force}
    run = Run("surge " + EVIL, t, channels, sha256="cd" * 32)
    vehicle = load_vehicle("box-hull")
    before = compare(vehicle, [run], compiled=False)
    data = report_data(before, compare(vehicle, [run], compiled=False), names=("old", "new"))
    assert data.maps[0].rows == ("surge",)
    assert np.nanmax(data.maps[0].before) > 3
    assert [trace.channel for trace in data.runs[0].traces] == ["u", "x"]
    assert {curve.unit for curve in data.residuals} == {"N"}
    assert data.settings["prediction ahead"].startswith("over 5 s, from ")
    assert {"Python", "numpy", "casadi"} <= set(data.versions)
    page = _Page(render_report(_diagnosis(), data))
    assert not page.open
    assert "old: fails most in surge" in page.text
    assert report_data(before).maps[0].after is None


# --- the pictures -----------------------------------------------------------------------------
def test_the_chart_of_steps_falls_to_the_floor() -> None:
    axis = falling_error(_diagnosis().steps).axes[0]
    floor, course = axis.lines
    assert set(floor.get_ydata()) == {1.0}
    assert list(course.get_ydata()) == [6.25, 1.02]
    assert [label.get_text() for label in axis.get_xticklabels()] == ["model as given", "+ mini-auv"]
    assert "noise" in axis.get_ylabel()
    low, high = axis.get_ylim()
    assert low < 1.0 < 6.25 < high


def test_the_ranking_draws_intervals_where_there_are_any() -> None:
    unknown = _ranked("lift", 0.01, interval=(-np.inf, np.inf))
    axis = ranking([_ranked("ocean_current", 30.0), unknown]).axes[0]
    intervals = [line for line in axis.lines if len(set(line.get_ydata())) == 1]
    assert [list(line.get_xdata()) for line in intervals] == [pytest.approx([26.95, 33.05])]
    assert [label.get_text() for label in axis.get_yticklabels()] == ["ocean_current", "lift"]
    assert axis.yaxis_inverted()


def test_the_ranking_has_few_ticks_and_ends_where_its_intervals_do() -> None:
    wide, sure = ranking([_ranked("lift", 1e5)]).axes[0], ranking([_ranked("lift", 30.0)]).axes[0]
    assert len(wide.get_xticks()) <= 9
    low, high = _ranked("lift", 30.0).interval
    assert sure.get_xlim()[1] < 5 * high
    assert sure.get_xlim()[0] > min(0.5 * low, -1.0)


def test_the_error_map_shows_every_number_and_a_dash() -> None:
    picture = error_map(_data().maps[0], ("as it is", "better"))
    upper, lower, bar = picture.axes
    assert [text.get_text() for text in upper.texts] == ["4", "–", "2", "9"]
    assert [text.get_text() for text in lower.texts] == ["1"] * 4
    assert (upper.get_title(loc="left"), lower.get_title(loc="left")) == ("as it is", "better")
    assert bar.get_ylabel() == "error / noise"
    assert upper.collections[0].norm.vmin == 1.0
    assert lower.collections[0].norm.vmax == upper.collections[0].norm.vmax == 9.0


def test_a_simulation_that_runs_away_does_not_flatten_the_rest() -> None:
    trace = _trace()
    wild = Trace("u", "m/s", trace.t, trace.measured, np.exp(trace.t), trace.after)
    axis = measured_vs_simulated(RunTraces("run", (wild,))).axes[0]
    low, high = axis.get_ylim()
    assert -4 < low < -1
    assert 1 < high < 4
    assert axis.get_ylabel() == "u [m/s]"
    assert axis.get_xlabel() == "time [s]"


def test_residuals_are_drawn_with_their_intervals_and_units() -> None:
    picture = residual_against(_data("u").residuals, ("old", "new"))
    axis = picture.axes[0]
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("u [m/s]", "surge residual [N]")
    assert axis.containers[0].lines[0].get_ydata() == pytest.approx(2 * np.linspace(-1, 1, 7))
    assert [c.get_label() for c in axis.containers] == ["old", "new"]


def test_two_models_on_bins_of_their_own_are_drawn_in_one_picture() -> None:
    """A value of each run is estimated from its first third, which the other model is not spared."""
    (curve, *_) = _data("u").residuals
    centre = np.linspace(-0.5, 0.5, 4)
    less = Profile("surge", "u", "m/s", centre, 0.0 * centre, np.full(4, 0.05), np.full(4, 9))
    axis = residual_against([replace(curve, after=less)]).axes[0]
    assert [c.lines[0].get_xdata().tolist() for c in axis.containers] == [
        curve.before.centre.tolist(),
        centre.tolist(),
    ]


def test_the_budget_is_sorted() -> None:
    axis = force_budget([Budget("surge", "N", {"a": 1.0, "b": 3.0, "c": 2.0})]).axes[0]
    assert [label.get_text() for label in axis.get_yticklabels()] == ["a", "c", "b"]
    assert axis.get_xlabel() == "surge, rms [N]"


def test_forces_of_a_large_ship_have_their_power_in_the_label() -> None:
    axis = force_budget([Budget("surge", "N", {"a": 1.5e6, "b": 3e5})]).axes[0]
    assert axis.get_xlabel() == "surge, rms [1e6 N]"
    np.testing.assert_allclose([bar.get_width() for bar in axis.patches], [0.3, 1.5])


def test_thinning_keeps_extremes_and_gaps() -> None:
    t = np.arange(100_000.0)
    values = np.sin(t / 3000)
    values[54_321], values[70_000:80_000] = 40.0, np.nan
    thin_t, thin = decimated(t, values)
    assert len(thin) <= 500
    assert np.nanmax(thin) == 40.0
    assert thin_t[np.nanargmax(thin)] == 54_321
    assert np.isnan(thin[(thin_t > 71_000) & (thin_t < 79_000)]).all()
    assert np.all(np.diff(thin_t) > 0)
    short = np.array([1.0, np.nan])
    assert decimated(np.arange(2.0), short)[1] is short


def test_drawing_leaves_the_settings_of_matplotlib_alone() -> None:
    before = dict(mpl.rcParams)
    svg(falling_error(_diagnosis().steps), "p")
    assert dict(mpl.rcParams) == before


def test_numbers_of_a_small_vehicle_do_not_run_into_each_other() -> None:
    """A yaw moment of 0.0005 N m, in a row of three panels: 0.00025 is too wide for any of them."""
    budgets = [Budget(dof, "N m", {"thrusters": 5.1e-4, "added_mass": 2.6e-4}) for dof in "abc"]
    picture = force_budget(budgets)
    FigureCanvasAgg(picture).draw()
    texts = [label.get_text() for label in picture.axes[2].get_xticklabels()]
    assert 2 <= len(texts) <= 6
    assert all(len(text) <= 3 for text in texts)


def test_pictures_can_be_written_and_the_folder_must_be_there(tmp_path: Path) -> None:
    picture = falling_error(_diagnosis().steps)
    save_png(picture, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(UndertowError, match="does not exist"):
        save_png(picture, tmp_path / "nowhere" / "a.png")


def test_the_same_diagnosis_gives_the_same_page() -> None:
    assert render_report(_diagnosis(), _data()) == _html()


# --- words and numbers ------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (5.12345, 0.01234, "(5.123 ± 0.012) kg"),
        (-0.5, 0.25, "(−0.50 ± 0.25) kg"),
        (1234.5, 56.0, "(1234 ± 56) kg"),
        (1.0, None, "1 kg"),
        (1.5, float("inf"), "1.5 kg"),
        (1.25e-12, 1e-13, "(1.25e−12 ± 1e−13) kg"),
    ],
)
def test_values_show_as_many_digits_as_they_are_known_to(
    value: float, error: float | None, text: str
) -> None:
    assert with_error(value, error, "kg") == text


def test_numbers_and_names_as_readers_expect_them() -> None:
    assert quantity(None, "kg") == "–"
    assert quantity(float("nan"), "kg") == "not finite kg"
    assert quantity(-1.5, "1") == "−1.5"
    assert percent(0.1234) == "12.3%"
    assert percent(None) == "–"
    assert parameter_text("X_uabsu") == "X_u|u|"
    assert parameter_text("N_rabsr") == "N_r|r|"
    assert parameter_text("gain_error_cabs") == "gain_error_cabs"
    assert unit_text("N m/((rad/s)^2)") == "N m/(rad/s)²"
    assert unit_text("N/(m/s)") == "N/(m/s)"
    assert with_unit("speed", "m/s^2") == "speed [m/s²]"
    assert with_unit("gain", "1") == "gain"


def test_labels_are_printable_and_short() -> None:
    assert plain("a\nb\x00$") == "a\N{REPLACEMENT CHARACTER}b\N{REPLACEMENT CHARACTER}\\$"
    assert len(plain("x" * 500)) == 48


def test_what_the_doctor_is_sure_of_comes_before_any_missing_effect() -> None:
    def reported(*found: Found) -> Diagnosis:
        examined = Examination(
            undertow="0.1.0", vehicle="v", runs=["a"], findings=list(found), excitation=[], seconds=1.0
        )
        return _with_doctor(_diagnosis(), examined, explained=False)

    mistake = Found(
        id="reversed_thruster", severity="mistake", text="a: thruster 'f1' pushes backwards: yaw shows it"
    )
    late = Found(id="late_velocity", severity="warning", text="velocity 0.2 s late")
    first = "First correct the mistakes in the logs or the vehicle file: thruster 'f1' pushes backwards."
    said = "Adding mini-auv lowers the residual from 6.25 to 1.02 times the noise on validation runs."
    assert reported(late, mistake).headline == f"{first} {said} headline of mini-auv"
    assert reported(mistake).warnings[0] == "mistake: a: thruster 'f1' pushes backwards: yaw shows it"
    assert reported(late).headline == f"{said} headline of mini-auv"


def test_warnings_of_the_doctor_stand_below_the_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    """A log that is late, or a compass that deviates, may be what the named effect makes up for."""
    late = Found(
        id="late_velocity", severity="warning", text="mini-auv: u is 0.2 s late: a delay corrects it"
    )
    quiet = Found(id="agreement", severity="note", text="pose rate over velocity: u 1.0")
    diagnosis = _diagnosis().model_copy(update={"doctor": [late, quiet]})
    show(SimpleNamespace(diagnosis=diagnosis))  # type: ignore[arg-type]
    said = " ".join(capsys.readouterr().out.split())
    assert "undertow doctor warns, and says what to do: u is 0.2 s late" in said
    assert "pose rate" not in said
    show(SimpleNamespace(diagnosis=_diagnosis()))  # type: ignore[arg-type]
    assert "undertow doctor warns" not in capsys.readouterr().out
    page = _words(render_report(diagnosis, _data()))
    assert "undertow doctor: mini-auv: u is 0.2 s late: a delay corrects it" in page
    assert "pose rate" not in page
    assert "undertow doctor" not in _words(render_report(_diagnosis(), _data()))


def test_an_effect_and_why_it_is_not_named_are_kept_apart(capsys: pytest.CaptureFixture[str]) -> None:
    """Reasons may be sentences: "lift it improves only the simulations" is none."""
    entry = _ranked("lift", 3.0).model_copy(update={"not_named": "it improves only the simulations"})
    show(SimpleNamespace(diagnosis=_diagnosis().model_copy(update={"ranking": [entry]})))  # type: ignore[arg-type]
    assert "not named: lift: it improves only" in " ".join(capsys.readouterr().out.split())


def test_what_a_written_vehicle_file_has_is_said() -> None:
    """That nothing was added, and that one of a set stands for others, must not be silent."""
    one_of_two = _diagnosis("indistinguishable")
    assert _content(one_of_two) == (
        "mini-auv added, values refitted; mini-auv stands for a set: it could equally be lift"
    )
    alone = one_of_two.model_copy(update={"indistinguishable": []})
    assert _content(alone) == "mini-auv added, values refitted"
    assert "none was added, since none was established" in _content(alone.model_copy(update={"effects": []}))


def test_an_error_that_rises_is_no_plain_yes() -> None:
    risen = _diagnosis().model_copy(update={"ranking": [_ranked("lift", 3.0, error_after=7.5)]})
    page = render_report(risen)
    assert ">in part" in page
    assert "In part: significant with a disturbance in the noise model" in page
    assert ">in part" not in render_report(_diagnosis())


def test_columns_that_contradict_each_other_are_explained() -> None:
    """An error that hardly falls beside a large share, and a small chance beside a no."""
    contrary = _ranked("wind", 3.0, error_before=41.2, error_after=40.2, explained=0.9)
    refused = _ranked("lift", 0.01, error_after=5.0, explained=0.36, p_value=0.001)
    plain = _ranked("lift", 0.01, error_after=5.0, explained=0.36, p_value=0.2)
    assert explanations([plain], 0.01) == []
    assert explanations([contrary], 0.01)[0].startswith("Explains: mean over the equations above the noise")
    assert explanations([refused], 0.01)[0].startswith("No, in spite of a small chance:")
    page = _words(render_report(_diagnosis().model_copy(update={"ranking": [contrary, refused]})))
    assert "Explains: mean over" in page
    assert "No, in spite of" in page


def test_an_adequate_model_that_leaves_a_disturbance_is_not_said_to_leave_noise() -> None:
    left = Predictability(
        degree_of_freedom="surge", unit="N", averaged_over=1.0, residual_rms=2.0, share=0.0,
        interval=(0.0, 0.1), significant=False, noise_share=0.2, disturbance_rms=1.6,
        relative_to_inertia=0.1, variables={},
    )  # fmt: skip
    noise, more = _diagnosis("adequate"), _diagnosis("adequate").model_copy(update={"predictable": [left]})
    assert "consistent with sensor noise" in _words(render_report(noise))
    page = _words(render_report(more))
    assert "consistent with sensor noise" not in page
    assert "it is treated as a disturbance" in page


def test_the_page_says_which_model_its_tables_are_of() -> None:
    """What remains and the parameters are those without effects that are not established."""
    helped = _diagnosis("helps_prediction").model_copy(
        update={"effects": [], "helps": ["lift"], "indistinguishable": []}
    )
    page = _words(render_report(helped, replace(_data(), headlines=("as it is", "with lift"))))
    assert "Residual of the refitted model, without lift on the validation data" in page
    assert "Fitted values of the refitted model, without lift with" in page
    assert "rms force or moment of each effect, better." in page
    assert "no other effect explains the data as well" not in page


@pytest.mark.parametrize(
    ("interval", "chance", "words"),
    [
        ((0.5, 1.5), 0.001, "yes"),
        ((0.5, 1.5), 0.0000181, "yes"),
        ((-0.5, 2.5), 0.001, "yes: in most blocks of the data, though their mean is uncertain"),
        ((-0.5, 2.5), 0.2, "yes: by simulation"),
    ],
)
def test_more_than_chance_agrees_with_the_interval_beside_it(
    interval: tuple[float, float], chance: float, words: str
) -> None:
    lift = _ranked("lift", 1.0, interval=interval, p_value=chance)
    page = render_report(_diagnosis().model_copy(update={"ranking": [lift]}))
    assert f'<td data-head="significant">{words}<br>' in page
    assert f"chance {'20.0%' if chance == 0.2 else '&lt; 0.2%'}<" in page


def test_what_does_nothing_is_folded_away_and_what_to_run_stands_on_top() -> None:
    idle = _ranked("wind", 0.0).model_copy(update={"parameters": [], "significant": False})
    found = _diagnosis().model_copy(
        update={"ranking": [_ranked("lift", 3.0), idle], "command": "undertow add lift rov.toml a.csv"}
    )
    page = render_report(found)
    assert page.index("undertow add lift rov.toml") < page.index("What this does not show")
    folded = page[page.index("<details>") : page.index("</details>")]
    assert "1 effect that does not improve the model" in folded
    assert "<code>wind</code>" in folded
    assert "<code>lift</code>" not in folded


def test_the_overlay_has_the_model_as_given_beside_both_others() -> None:
    trace = replace(_trace(), given=0.5 * np.sin(0.2 * _trace().t))
    picture = measured_vs_simulated(RunTraces("run", (trace,)), ("refitted", "with lift"))
    labels = [line.get_label() for line in picture.axes[0].lines]
    assert labels == ["model as given", "measured", "refitted", "with lift"]
