"""The pages as a user meets them, without a browser: NiceGUI's simulated user clicks and looks."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from threading import Thread
from typing import Any

import polars as pl
import pytest

pytest.importorskip("nicegui", reason="the extra 'workbench' (NiceGUI) is not installed")

from nicegui import ui
from nicegui.testing import User, user_simulation

from tests.workbench.demo_session import DEMO, FewEffects, session_of
from undertow.errors import UndertowError
from undertow.workbench.bench import Bench, Work, Worker
from undertow.workbench.server import TokenGate, set_up, window
from undertow.workbench.session import LogChoice, ModelStep, Remedy, Workspace
from undertow.workbench.tasks import TASKS

TOKEN = "a-token"
Story = Callable[[User, Bench], Awaitable[None]]


class InThread(Worker):
    """Work in a thread of this process: to start another one takes longer than the work."""

    def start(self, place: Workspace, task: str, args: dict[str, Any]) -> None:
        self.work = work = Work(task, place.key)
        Thread(target=self._do, args=(place, work, args)).start()

    def _do(self, place: Workspace, work: Work, args: dict[str, Any]) -> None:
        job = FewEffects(
            Workspace(place.folder, place.session.model_copy(deep=True)), args, lambda d, w: None
        )
        try:
            self._finished(work, {"result": TASKS[work.task][0](job)})
        except UndertowError as error:
            self._finished(work, {"failed": str(error)})


def _played(story: Story, folder: Path, wanted: Any = None) -> None:
    """Let a user go through a story on the session of a folder."""
    bench = Bench.open(folder, wanted, InThread)
    try:
        asyncio.run(_play(story, bench))
    finally:
        bench.close()


async def _play(story: Story, bench: Bench) -> None:
    async with _opened(bench) as user:
        await story(user, bench)


@contextlib.asynccontextmanager
async def _opened(bench: Bench) -> AsyncIterator[User]:
    async with user_simulation(root=lambda: window(bench)) as user:
        set_up(bench, TOKEN, 1)
        await _soon(lambda: not bench.reading)
        yield user


async def _soon(done: Callable[[], bool]) -> None:
    for _ in range(3000):
        if done():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("not done after a minute")


def _played_on(place: Workspace, story: Story) -> None:
    _played(story, place.folder, place.session)


def _texts(user: User) -> str:
    """All that the page says."""
    with user:
        found = [e.text for e in user.find(ui.label).elements]
    return "\n".join(found)


def _figure(user: User, marker: str) -> dict[str, Any]:
    (plot,) = user.find(marker=marker).elements
    assert isinstance(plot, ui.plotly)
    return dict(plot.figure)  # type: ignore[arg-type]


def _dashed(figure: dict[str, Any]) -> list[tuple[float, float]]:
    """The stretch that is chosen, as it is drawn."""
    shapes = figure["layout"]["shapes"]
    return [(s["x0"], s["x1"]) for s in shapes if s.get("line", {}).get("dash") == "dash"]


def test_the_log_page_shows_every_channel_and_takes_stretches(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}")
        await user.should_see("1200 samples, 59.95 s")
        figure = _figure(user, "channels-plot")
        titles = [v["title"]["text"] for k, v in figure["layout"].items() if k.startswith("yaxis")]
        assert titles[:5] == ["u (m/s)", "v (m/s)", "w (m/s)", "r (rad/s)", "f1"]
        with user:
            user.find(marker="channels-plot").trigger(
                "plotly_selected", {"range": {"x": [12.0, 20.0], "y3": [0, 1]}}
            )
        await user.should_see("chosen: 12 to 20 s")
        user.find(marker="page-out").click()
        user.find(marker="page-log").click()
        await user.should_see("chosen: 12 to 20 s")
        assert _dashed(_figure(user, "channels-plot")) == [(12.0, 20.0)]
        user.find(marker="choose-out").click()
        await user.should_see("0-12 s training, 12-20 s left out, 20-59.95 s training")
        assert Workspace.open(place.folder, place.session).session.logs[0].stretches[0].role == "out"
        user.find(marker="channels-plot").trigger(
            "plotly_relayout", {"xaxis.range[0]": 30.0, "xaxis.range[1]": 31.0}
        )
        await asyncio.sleep(0.05)
        assert not _dashed(_figure(user, "channels-plot"))
        shown_path = _figure(user, "channels-plot")["data"][0]["x"]
        assert 29.9 < shown_path[0] <= 30.0
        assert 31.0 <= shown_path[-1] < 31.1

    _played_on(place, story)


def test_the_log_page_says_how_a_log_was_read(tmp_path: Path) -> None:
    table = pl.read_csv(DEMO / "train_1.csv.gz", infer_schema_length=None).head(300)
    names = {"x": "NAV_X", "y": "NAV_Y", "z": "NAV_DEPTH", "psi": "NAV_HEADING"} | {
        n: n for n in ("f1", "f2", "f3", "f4")
    }
    rows = [f"{row['t']} {names[n]} pNav {row[n]}" for row in table.iter_rows(named=True) for n in names]
    log = tmp_path / "dive.alog"
    log.write_text("%% LOG FILE: dive.alog\n%% LOGSTART 1000.0\n" + "\n".join(rows) + "\n")
    wanted = session_of(tmp_path).model_copy(update={"logs": [LogChoice(path=str(log))]})

    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}")
        await user.should_see("read as MOOS")
        (run,) = bench.runs
        assert run.reader_notes[0] == "read as MOOS"
        assert set(run.reader_notes) | set(run.notes) <= set(_texts(user).splitlines())

    _played(story, tmp_path / "kept", wanted)


@pytest.mark.slow
def test_where_it_fails_shows_the_worst_cell_and_any_other(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}&page=fails")
        await user.should_see(marker="headline", content="Fails most in yaw")
        await user.should_see(marker="cell", content="yaw")
        (frame,) = _figure(user, "error-map")["layout"]["shapes"]
        heat = _figure(user, "error-map")["data"][0]
        worst = max(v for row in heat["z"] for v in row if v is not None)
        assert heat["z"][round(frame["y0"] + 0.46)][round(frame["x0"] + 0.48)] == worst
        user.find(marker="error-map").trigger("plotly_click", [0, 1])
        await user.should_see(marker="cell", content="sway, slow")
        names = [trace.get("name") for trace in _figure(user, "residual-against")["data"]]
        assert "mean in bins" in names
        assert "95% of the mean" in names
        assert "ocean_current would add" in names
        user.find(marker="page-log").click()
        await user.should_see("yellow: sway, slow")

    _played_on(place, story)


@pytest.mark.slow
def test_what_is_missing_lists_candidates_and_draws_the_one_pointed_at(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}&page=missing")
        await user.should_see("An effect is missing")
        await user.should_see(marker="candidate-ocean_current")
        said = _texts(user)
        assert "V_N = (0.1" in said
        assert "No other effect does as well on these logs." in said
        names = {trace["name"] for trace in _figure(user, "simulation")["data"]}
        assert names == {"measured", "model refitted", "with ocean_current"}
        (details,) = user.find(marker="details-ocean_current").elements
        assert isinstance(details, ui.expansion)
        with user:
            details.set_value(True)
        await user.should_see(marker="equation")
        drawn = [e.content for e in user.find(marker="equation").elements if isinstance(e, ui.html)]
        assert all('src="data:image/svg+xml;base64,' in picture for picture in drawn)
        assert any('alt="water north = V_N"' in picture for picture in drawn)
        (select,) = user.find(marker="measure").elements
        assert isinstance(select, ui.select)
        assert next(iter(select.options)) == "force"
        longest = list(select.options)[-2]
        with user:
            select.set_value(longest)
        await _soon(lambda: bench.session.measure == longest)

    _played_on(place, story)


@pytest.mark.slow
def test_rivals_come_with_the_manoeuvre_and_what_remains_becomes_an_effect(place: Workspace) -> None:
    found = place.result("diagnose")
    assert found is not None
    alike = {"effects": ["slosh", "lift"], "reason": ""}  # a set beside the effect that is established
    found["diagnosis"] |= {"verdict": "indistinguishable", "indistinguishable": [alike]}
    found["candidates"][0] |= {"confused": ["constant_force"], "tell": "turn on the spot for 40 s"}
    left = found["diagnosis"]["remaining"][0]
    left["summary"] = "surge: 0.4 N rms correlates with |u| u"
    left["depends_on"] = [
        {
            "term": "|u|u", "columns": [["|u|", "u"]], "coefficients": [2.0], "standard_errors": [0.1],
            "units": ["kg/m"], "share": 0.5, "chance": 0.001, "alike": [],
        }
    ]  # fmt: skip
    place.keep("diagnose", place.key, found)

    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}&page=missing")
        await user.should_see("An effect is missing, and another that these logs cannot tell from others")
        said = _texts(user)
        assert "These logs hardly distinguish it from constant_force." in said
        assert "To tell them apart: turn on the spot for 40 s" in said
        assert "undertow plan " in said
        assert "--goal separate --between ocean_current,constant_force" in said
        assert "surge: 0.4 N rms correlates with |u| u" in said
        user.find(marker="invent").click()
        await _soon(lambda: bench.work is None)
        assert bench.failure == ""
        await _soon(lambda: "add-my_force" in _markers(user))
        await user.should_not_see(marker="stale")  # an effect more changes neither model nor logs
        assert (place.folder / "my_force.py").exists()

    _played_on(place, story)


def test_add_lets_the_waterfall_fall_and_undo_takes_it_back(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}&page=missing")
        user.find(marker="add-ocean_current").click()
        await _soon(lambda: bench.work is None)
        assert bench.failure == ""
        await _soon(lambda: "waterfall" in _markers(user))
        heights = _figure(user, "waterfall")["data"][0]["y"]
        assert heights[0] > heights[1] > 5.0
        assert heights[-1] == pytest.approx(1.0, abs=0.1)
        await user.should_see("in the model")
        await user.should_see(marker="stale")
        user.find(marker="undo").click()
        await _soon(lambda: "undo" not in _markers(user))
        await user.should_see(marker="add-ocean_current")
        await user.should_not_see(marker="stale")
        assert [step.what for step in bench.session.steps] == ["as given"]

    _played_on(place, story)


def _markers(user: User) -> set[str]:
    with user:
        return {m for e in ui.context.client.elements.values() for m in e._markers}  # NiceGUI's


@pytest.mark.slow
def test_parameters_are_shown_with_their_doubts_and_edited(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}&page=parameters")
        await user.should_see("X_u|u|")
        (cell,) = user.find(marker="value-X_u").elements
        (box,) = user.find(marker="free-Y_v").elements
        assert isinstance(cell, ui.number)
        assert isinstance(box, ui.checkbox)
        with user:
            cell.set_value(-0.7)
            box.set_value(False)
        user.find(marker="apply").click()
        await _soon(lambda: bench.work is None)
        assert bench.failure == ""
        assert bench.session.steps[-1].what == "X_u = -0.7 estimated, Y_v = -2.769 fixed"
        assert bench.vehicle.value_of("X_u").value == -0.7

    _played_on(place, story)


@pytest.mark.slow
def test_out_gives_the_command_lines(place: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place.folder.parent)
    place.session.steps.append(ModelStep(what="with lift", file="", effect="lift", command="add lift"))
    place.session.steps[-1].file = "model-1.toml"
    (place.folder / "model-1.toml").write_text((DEMO / "vehicle.toml").read_text())
    place.save()

    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}&page=out")
        said = _texts(user)
        logs = f"{DEMO / 'train_1.csv.gz'} --validation {DEMO / 'holdout.csv.gz'}"
        assert f"undertow diagnose vehicle.toml {logs} --json diagnosis.json" in said
        assert f"undertow add lift vehicle.toml {logs} --out model-1.toml" in said
        assert "undertow export c model-1.toml" in said
        user.find(marker="write-vehicle").click()
        await _soon(lambda: bench.work is None)
        assert bench.said == "wrote vehicle-better.toml"
        assert Path("vehicle-better.toml").exists()

    _played_on(place, story)


@pytest.mark.slow
def test_two_windows_and_a_reload_share_the_work(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        first = await user.open(f"/?token={TOKEN}")
        bench.choose(0, "judge")
        await user.open("/")
        assert user.client is not first
        with user:
            (toggle,) = user.find(marker="role-0").elements
        assert isinstance(toggle, ui.toggle)
        assert toggle.value == "judge"
        stored = json.loads((place.folder / "session.json").read_text())
        assert stored["logs"][0]["role"] == "judge"

    _played_on(place, story)


@pytest.mark.slow
def test_a_remedy_mends_the_mapping_and_shows_before_and_after(tmp_path: Path) -> None:
    """A heading in degrees: found, mended, and the log then agrees with itself."""
    degrees = pl.col("psi") * 57.29577951308232
    log = tmp_path / "dive.csv"
    pl.read_csv(DEMO / "train_1.csv.gz", infer_schema_length=None).with_columns(degrees).write_csv(log)
    wanted = session_of(tmp_path).model_copy(update={"logs": [LogChoice(path=str(log))]})

    async def story(user: User, bench: Bench) -> None:
        await user.open(f"/?token={TOKEN}")
        user.find(marker="do-examine").click()
        await _soon(lambda: bench.work is None)
        await _soon(lambda: "remedy-0" in _markers(user))
        assert "psi is in degrees" in _texts(user)
        user.find(marker="remedy-0").click()
        await _soon(lambda: bench.work is None and not bench.reading)
        await _soon(lambda: "No mistake found" in _texts(user))
        assert bench.session.remedies == [
            Remedy(id="degrees_for_radians", lines='[columns]\npsi = { channel = "psi", unit = "deg" }')
        ]
        before, after = bench.before[0].channels["psi"], bench.runs[0].channels["psi"]
        assert before.max() / after.max() == pytest.approx(57.2958, rel=1e-4) or before.max() > 50.0
        figure = _figure(user, "channels-plot")
        assert figure["layout"]["yaxis"]["title"]["text"] == "psi (rad)"  # what was mended comes first
        assert figure["data"][0]["name"] == "before"
        user.find(marker="undo-remedy").click()
        await _soon(lambda: not bench.reading)
        assert bench.session.remedies == []

    _played(story, tmp_path / "kept", wanted)


def test_names_out_of_files_are_text(tmp_path: Path) -> None:
    name = "<script>alert(1)</script>"
    log = tmp_path / f"{name.replace('/', '∕')}.csv"
    frame = pl.read_csv(DEMO / "train_1.csv.gz", infer_schema_length=None)
    frame.with_columns(pl.col("u").alias(name)).write_csv(log)
    vehicle = tmp_path / "given.toml"
    text = (DEMO / "vehicle.toml").read_text()
    vehicle.write_text(text.replace('name = "mini-auv"', f'name = "{name}"'))
    mapping = tmp_path / "log.toml"
    mapping.write_text(f'schema = "undertow/mapping/1"\n[columns]\n"{name}" = {{ channel = "{name}" }}\n')
    wanted = session_of(tmp_path).model_copy(
        update={"logs": [LogChoice(path=str(log))], "vehicle": str(vehicle), "mapping": str(mapping)}
    )

    async def story(user: User, bench: Bench) -> None:
        for page in ("log", "fails", "missing", "parameters", "out"):
            response = await user.http_client.get(f"/?token={TOKEN}&page={page}")
            assert "<script>alert" not in response.text
        await user.open(f"/?token={TOKEN}")
        (select,) = user.find(marker="channels").elements
        assert isinstance(select, ui.select)
        with user:
            select.set_value([name, "u"])
        await asyncio.sleep(0.05)
        assert "<script" not in json.dumps(_figure(user, "channels-plot"))
        assert name in _texts(user)  # as text, in a label

    _played(story, tmp_path / "kept", wanted)


def test_nothing_is_answered_without_the_token(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        for path in ("/", "/?token=", "/?token=another", "/?page=out", "/_nicegui/any.css"):
            response = await user.http_client.get(path)
            assert response.status_code == 403
            assert "mini-auv" not in response.text

    _played_on(place, story)


def test_the_token_is_exchanged_for_a_cookie_and_nothing_comes_from_outside(place: Workspace) -> None:
    async def story(user: User, bench: Bench) -> None:
        response = await user.http_client.get(f"/?token={TOKEN}")
        cookie = response.headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert "default-src 'self'" in response.headers["content-security-policy"]
        assert (await user.http_client.get("/")).status_code == 200  # the cookie is enough now
        assert _outside(response.text) == []

    _played_on(place, story)


def _outside(page: str) -> list[str]:
    """Addresses of other places that the page would fetch from."""
    found = re.findall(r"""(?:src|href)=["'](https?:)?//([^"'/]+)""", page)
    return [host for _, host in found if host != "test"]


def test_a_websocket_without_the_token_is_closed() -> None:
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    async def never(*_: Any) -> None:
        raise AssertionError("the application was reached")

    gate = TokenGate(never, TOKEN, "cookie")
    asyncio.run(gate({"type": "websocket", "query_string": b"", "headers": []}, receive, send))
    assert sent == [{"type": "websocket.close", "code": 1008}]
