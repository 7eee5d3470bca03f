"""Bad input: one clear line on stderr, exit code 2 (130 for Ctrl-C), and nothing written."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tomlkit.exceptions import TOMLKitError

from benchmarks.hidden_effects import Case
from tests.cli.bad import (
    LOG_COMMANDS,
    SURGE,
    VEHICLE_COMMANDS,
    Columns,
    contents,
    each_once,
    refusal,
    surge_log,
    text_of,
)
from tests.failing import HalfWritten
from tests.quick import first_quick, quick_if
from undertow import files
from undertow.cli.main import main, run

Capture = pytest.CaptureFixture[str]
ROOT = Path(__file__).parents[2]


def _words(command: str, vehicle: object = "usv.toml", log: object = "train.csv") -> list[object]:
    first = {"add": ["add", "constant_force"], "export": ["export", "c"]}.get(command, [command])
    return [*first, vehicle] if command == "export" else [*first, vehicle, log]


# --- the vehicle file ----------------------------------------------------------------------------

_M = "m = 23.8"
# One of each stage of reading; all of them: tests/model/test_vehicle_file.py.
VEHICLES = {
    "wrong key at the top": ("name =", "nam =", ["'nam'", "'name'"]),
    "no TOML": ("[effects.rigid_body]", "[effects.rigid_body", ["TOML", "line"]),
    "unit that does not fit": (_M, 'm = "23.8 m"', ["m", "kg", "23.8 m"]),
    "negative mass": (_M, "m = -23.8", ["m = -23.8", "is impossible"]),
    "inertia that cannot be": ("I_z = 1.76", "I_z = 0.001\nx_gg = 1", ["x_gg", "x_g"]),
}


@pytest.mark.parametrize(("command", "fault"), each_once(VEHICLE_COMMANDS, VEHICLES))
def test_a_vehicle_file_with_a_fault_is_refused(
    command: str, fault: str, case: Path, capsys: Capture
) -> None:
    old, new, words = VEHICLES[fault]
    text = (case / "usv.toml").read_text()
    assert old in text
    (case / "bad.toml").write_text(text.replace(old, new, 1))
    line = refusal(_words(command, "bad.toml"), capsys, case)
    assert all(word in line for word in ["bad.toml", *words]), line


@pytest.mark.parametrize("content", [b"", b"\x00\xff\x10PK", b"name = '\xff'", b"a" + b".b" * 5000 + b"=1"])
def test_what_is_no_vehicle_file_is_refused(content: bytes, case: Path, capsys: Capture) -> None:
    (case / "bad.toml").write_bytes(content)
    assert "bad.toml" in refusal(_words("compare", "bad.toml"), capsys, case)


@pytest.mark.parametrize("vehicle", ["nothing.toml", ".", "mini-avu", "x" * 5000, "new\nline", ""])
def test_a_vehicle_that_is_not_there_is_refused(vehicle: str, case: Path, capsys: Capture) -> None:
    for command in VEHICLE_COMMANDS:
        assert "bundled are bluerov2" in refusal(_words(command, vehicle), capsys, case)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["effects", "show", "lfit"], "effect 'lfit' is not known (did you mean 'lift'?)"),
        (["effects", "check", "nothing.py"], "'nothing.py'"),
        (["effects", "check", "usv.toml"], "'usv.toml'"),
        (["effects", "check", "broken.py"], "SyntaxError"),
        (["effects", "--effects", "two_lines.py"], "ValueError: one two"),
        (["effects", "check", "empty.py"], "holds no effect"),
        (["export", "c", "usv.toml", "--effects", "nothing.py"], "'nothing.py'"),
    ],
)
def test_effects_that_are_not_there_are_refused(
    words: list[str], named: str, case: Path, capsys: Capture
) -> None:
    (case / "broken.py").write_text("def (:\n")
    (case / "empty.py").write_text("")
    (case / "two_lines.py").write_text("raise ValueError('one\\ntwo')\n")
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    try:
        assert named in refusal(words, capsys, case)
    finally:
        sys.dont_write_bytecode = before


# --- logs ----------------------------------------------------------------------------------------

Change = Callable[[Columns], Columns]


def _at(name: str, rows: object, value: float) -> Change:
    def change(columns: Columns) -> Columns:
        data = columns[name].copy()
        data[rows] = value
        return {**columns, name: data}

    return change


def _rows(rows: object) -> Change:
    return lambda columns: {name: data[rows] for name, data in columns.items()}


def _without(*names: str) -> Change:
    return lambda columns: {name: data for name, data in columns.items() if name not in names}


# What is wrong with a table by itself: tests/identification/test_logs_reading.py.
LOGS: dict[str, tuple[Change, list[str]]] = {
    "one sample": (_rows(slice(0, 1)), ["one sample", "at least 2"]),
    "ten samples": (_rows(slice(0, 10)), ["the longest stretch has 10", "21 are needed"]),
    "thruster missing": (_without("f2"), ["'f2'"]),
    "velocities and pose missing": (_without("x", "y", "psi", "u", "v", "r"), ["u"]),
    "Inf in a command": (_at("f1", 40, -np.inf), ["'f1'", "infinite", "t = 2 s"]),
}


@pytest.mark.parametrize(("command", "fault"), each_once(LOG_COMMANDS, LOGS))
def test_a_log_with_a_fault_is_refused(
    command: str, fault: str, case: Path, simulated: Case, capsys: Capture
) -> None:
    change, words = LOGS[fault]
    (case / "bad.csv").write_text(text_of(change(simulated.runs["multisine"])))
    line = refusal(_words(command, log="bad.csv"), capsys, case)
    assert all(word in line for word in ["bad", *words]), line


FILES = {
    "binary": (bytes(range(256)) * 40, "bad.csv"),
    "an ELF program": (Path(sys.executable).resolve().read_bytes()[:5000], "bad.csv"),
    "text of zeros": (b"\0" * 4096, "bad.csv"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "UTF-8"),
    "a page": (b"<!doctype html><title>404</title>", "'t'"),
    "escape sequences": (b"t,\x1b[31mred\x1b[0m\n0,1\n1,2\n", "'f1'"),
}


@pytest.mark.parametrize("fault", FILES)
def test_a_file_that_is_no_log_is_refused(fault: str, case: Path, capsys: Capture) -> None:
    content, word = FILES[fault]
    (case / "bad.csv").write_bytes(content)
    line = refusal(_words("compare", log="bad.csv"), capsys, case)
    assert "bad.csv" in line
    assert word in line


@pytest.mark.parametrize("log", ["nothing.csv", ".", "y" * 5000, "usv.toml"])
def test_a_log_that_is_not_there_is_refused(log: str, case: Path, capsys: Capture) -> None:
    for command in LOG_COMMANDS:
        assert log in refusal(_words(command, log=log), capsys, case)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[columns", "TOML"),
        ('schema = "undertow/mapping/1"\n[columns]\nu = { channel = "u", unit = "kg" }', "kg"),
    ],
)
def test_a_mapping_with_a_fault_is_refused(text: str, named: str, case: Path, capsys: Capture) -> None:
    (case / "map.toml").write_text(text)
    assert named in refusal([*_words("compare"), "--map", "map.toml"], capsys, case)


@pytest.mark.parametrize("command", LOG_COMMANDS)
def test_the_same_log_twice_is_refused(command: str, case: Path, capsys: Capture) -> None:
    shutil.copy(case / "train.csv", case / "again.csv")
    assert "have the same content: give each only once" in refusal(
        [*_words(command), "again.csv"], capsys, case
    )


@pytest.mark.parametrize("command", LOG_COMMANDS)
@pytest.mark.parametrize("vehicle", ["usv.toml", "otter"])
def test_a_log_in_the_place_of_the_vehicle_is_refused(
    command: str, vehicle: str, case: Path, capsys: Capture
) -> None:
    line = refusal(_words(command, "train.csv", vehicle), capsys, case)
    assert "'train.csv' is a log in the place of the vehicle" in line
    assert f"'{vehicle}' a vehicle in the place of a log" in line
    order = "EFFECT[,EFFECT] VEHICLE LOG" if command == "add" else "VEHICLE LOG"
    assert line.endswith(f"the order is undertow {command} {order}")


def test_two_logs_without_a_vehicle_are_refused(case: Path, capsys: Capture) -> None:
    line = refusal(["doctor", "train.csv", "train.csv"], capsys, case)
    assert "'train.csv' is a log in the place of the vehicle: the order" in line


def test_a_vehicle_in_the_place_of_the_effect_is_named(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal(["add", "usv.toml", "lift", "train.csv"], capsys, case)
    assert "'usv.toml' is a vehicle in the place of the effect, and 'lift' an effect in the place" in line
    assert "undertow add EFFECT VEHICLE LOG" in line


def test_a_vehicle_file_may_have_any_name(quick: Path, capsys: Capture) -> None:
    shutil.copy("usv.toml", "usv.txt")
    assert main(["doctor", "usv.txt", "none.csv"]) == 2
    assert "log none.csv does not exist" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "meant"), [("uvs.toml", "usv.toml"), ("usv", "usv.toml"), ("oter", "otter")]
)
def test_a_mistyped_vehicle_gets_the_nearest_name(
    name: str, meant: str, quick: Path, capsys: Capture
) -> None:
    for source in (name, str(quick / name)):
        assert main(["doctor", source, "train.csv"]) == 2
        assert f"(did you mean '{meant}'?)" in capsys.readouterr().err


@pytest.mark.parametrize("window", [["--from", "500"], ["--to", "-1"], ["--from", "3", "--to", "2"]])
def test_a_window_without_samples_is_refused(window: list[str], case: Path, capsys: Capture) -> None:
    for command in LOG_COMMANDS:
        assert "no sample in the time window" in refusal([*_words(command), *window], capsys, case)


# --- logs that say nothing, or little ------------------------------------------------------------


def _still(columns: Columns) -> Columns:
    """Sensors on, nothing moves: sensor noise, no command."""
    rng = np.random.default_rng(0)
    noise = {name: 0.01 * rng.standard_normal(len(columns["t"])) for name in columns if name != "t"}
    return {
        "t": columns["t"],
        **noise,
        "f1": 0 * columns["t"],
        "f2": 0 * columns["t"],
        "f3": 0 * columns["t"],
    }


def _dead(columns: Columns) -> Columns:
    """No sensor changes at all."""
    return {name: data if name == "t" else 0 * data for name, data in columns.items()}


@pytest.mark.parametrize("change", [_still, _dead])
@pytest.mark.parametrize("command", [c for c in LOG_COMMANDS if c != "compare"])
def test_a_log_in_which_nothing_moves_is_refused(
    command: str, change: Change, case: Path, simulated: Case, capsys: Capture
) -> None:
    (case / "still.csv").write_text(text_of(change(simulated.runs["multisine"])))
    line = refusal(_words(command, log="still.csv"), capsys, case)
    assert re.search("nothing moves.*log a manoeuvre|u = 0, v = 0, r = 0 over all 400.*not excited", line)


@pytest.mark.parametrize(
    "change", first_quick([_still, _dead, _at("u", slice(None), 0.3), _at("r", slice(9, 12), np.nan)], 2)
)
def test_comparing_with_a_poor_log_is_an_answer_in_finite_numbers(
    change: Change, case: Path, simulated: Case, capsys: Capture
) -> None:
    (case / "poor.csv").write_text(text_of(change(simulated.runs["multisine"])))
    assert main(["compare", "usv.toml", "poor.csv", "--json", "out.json"]) == 0, capsys.readouterr().err
    json.loads((case / "out.json").read_text(), parse_constant=_refuse)


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} in JSON")


def test_a_dead_channel_is_reported(case: Path, simulated: Case, capsys: Capture) -> None:
    (case / "dead.csv").write_text(text_of(_at("u", slice(None), 0.3)(simulated.runs["multisine"])))
    for command in [c for c in LOG_COMMANDS if c != "compare"]:
        line = refusal(_words(command, log="dead.csv"), capsys, case)
        assert "u = 0.3" in line
        assert "dead" in line


# --- 10^6 samples --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def million(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log of 10^6 samples."""
    folder = tmp_path_factory.mktemp("million")
    surge_log(10**6).write_parquet(folder / "million.parquet")
    (folder / "hull.toml").write_text(SURGE)
    return folder


@pytest.mark.slow
def test_comparing_with_a_million_samples_is_an_answer(million: Path, capsys: Capture) -> None:
    out = million / "out.json"
    words = _words("compare", million / "hull.toml", million / "million.parquet")
    assert main([*map(str, words), "--json", str(out)]) == 0
    result = json.loads(out.read_text())
    assert result["runs"][0]["samples"] == 10**6
    assert result["dofs"][0]["explained_by_noise"] > 0.8  # the model is the one that made the log
    out.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["fit", "add", "diagnose"])
def test_of_more_samples_than_a_search_can_take_those_that_tell_most_are_used(
    command: str, million: Path, capsys: Capture
) -> None:
    out = million / "out.json"
    words = _words(command, million / "hull.toml", million / "million.parquet")
    assert main([*map(str, words), "--json", str(out)]) in (0, 1), capsys.readouterr().err  # 1: no help
    long = json.loads(out.read_text())["long_logs"]
    assert long["logs"][0]["samples"] == 10**6
    assert 0 < long["information_share"] < 1
    assert {s["role"] for s in long["chosen"]} == {"train", "holdout"}
    used = sum(s["samples"] for s in long["chosen"])
    assert used + long["rest"]["samples"] == pytest.approx(10**6 / long["every"], rel=0.01)
    assert "segments" in capsys.readouterr().out
    out.unlink()


# --- outputs -------------------------------------------------------------------------------------

OUTPUTS = [
    ("compare", ["--json", "{}/out.json"]),
    ("compare", ["--plots", "{}"]),
    ("diagnose", ["--json", "{}/out.json"]),
    ("diagnose", ["--report", "{}/out.html"]),
    ("diagnose", ["--apply", "{}/out.toml"]),
    ("add", ["--force", "--no-codegen", "--out", "{}/out.toml"]),
    ("add", ["--picture", "{}/out.png"]),
    ("fit", ["--out", "{}/out.toml"]),
    ("export", ["--out", "{}"]),
]


def _writing(command: str, options: list[str], folder: object) -> list[object]:
    return [*_words(command), *(option.format(folder) for option in options)]


@pytest.mark.parametrize(("command", "options"), OUTPUTS)
def test_a_read_only_folder_is_refused_before_the_work(
    command: str, options: list[str], case: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Root may write anywhere, so the answers of the system are imitated.
    out = case / "closed"
    out.mkdir()
    asked = os.access
    monkeypatch.setattr(os, "access", lambda p, mode: mode != os.W_OK and asked(p, mode))
    _refuse_folders_in(out, monkeypatch)
    (case / "train.csv").write_text("read before the outputs were checked")
    line = refusal(_writing(command, options, out), capsys, case)
    assert str(out) in line
    assert "permission denied" in line.lower()


def _refuse_folders_in(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = Path.mkdir

    def mkdir(path: Path, *args: object, **options: object) -> None:
        if out in path.parents:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        made(path, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Path, "mkdir", mkdir)


@pytest.mark.parametrize(("command", "options"), [o for o in OUTPUTS if "/" in o[1][-1]])
def test_a_folder_that_is_not_there_is_refused_before_the_work(
    command: str, options: list[str], case: Path, capsys: Capture
) -> None:
    (case / "train.csv").write_text("read before the outputs were checked")
    assert "'nowhere' does not exist" in refusal(_writing(command, options, "nowhere"), capsys, case)


@pytest.mark.parametrize(("command", "options"), OUTPUTS)
def test_a_file_in_place_of_the_folder_is_refused(
    command: str, options: list[str], case: Path, capsys: Capture
) -> None:
    assert "train.csv" in refusal(_writing(command, options, "train.csv"), capsys, case)


# A file of text, a folder, a vehicle, code; other commands write such files by the same functions.
_KINDS = [OUTPUTS[k] for k in (0, 1, 7, 8)]
FAILURES = [
    (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), 2, "no space left on device; nothing was written"),
    (OSError(errno.EROFS, os.strerror(errno.EROFS)), 2, "read-only file system; nothing was written"),
    (KeyboardInterrupt(), 130, "interrupted"),
]


@pytest.mark.parametrize(
    ("command", "options", "failure"),
    quick_if(
        lambda case: case[:2] in _KINDS,
        [
            *((*output, FAILURES[0]) for output in OUTPUTS),
            *((*OUTPUTS[0], failure) for failure in FAILURES[1:]),
        ],
    ),
)
def test_a_write_that_fails_leaves_nothing_behind(
    command: str,
    options: list[str],
    failure: tuple[BaseException, int, str],
    quick: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    happens, code, word = failure
    (quick / "out").mkdir()
    monkeypatch.setattr(files, "open", lambda path, mode: HalfWritten(path, happens), raising=False)
    before = contents(quick)
    words = [str(word) for word in _writing(command, options, "out")]
    assert main(words) == code
    assert word in capsys.readouterr().err
    assert contents(quick) == before


def test_an_older_result_survives_a_full_disk(
    case: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    (case / "out.json").write_text("older")
    monkeypatch.setattr(files, "open", lambda path, mode: HalfWritten(path, FAILURES[0][0]), raising=False)
    assert "out.json" in refusal([*_words("compare"), "--json", "out.json"], capsys, case)


@pytest.mark.parametrize(
    ("command", "options", "named"),
    [
        ("compare", ["--json", "train.csv"], "train.csv"),
        ("compare", ["--json", "./usv.toml"], "usv.toml"),
        ("diagnose", ["--json", "train.csv"], "train.csv"),
        ("diagnose", ["--report", "link.csv"], "train.csv"),
        ("diagnose", ["--apply", "usv.toml"], "usv.toml"),
        ("diagnose", ["--out", "usv.toml"], "usv.toml"),
        ("diagnose", ["--validation", "holdout.csv", "--apply", "holdout.csv"], "holdout.csv"),
        ("diagnose", ["--map", "map.toml", "--apply", "map.toml"], "map.toml"),
        ("fit", ["--out", "train.csv"], "train.csv"),
        ("add", ["--out", "usv.toml"], "usv.toml"),
        ("add", ["--out", "train.csv"], "train.csv"),
        ("add", ["--in-place", "--picture", "train.csv"], "train.csv"),
    ],
)
def test_an_output_that_is_an_input_is_refused(
    command: str, options: list[str], named: str, case: Path, capsys: Capture
) -> None:
    (case / "link.csv").symlink_to("train.csv")
    (case / "map.toml").write_text('schema = "undertow/mapping/1"\n')
    line = refusal([*_words(command), *options], capsys, case)
    assert named in line
    assert "another" in line


def test_one_file_for_two_outputs_is_refused(case: Path, capsys: Capture) -> None:
    words = [*_words("diagnose"), "--json", "out", "--report", "./out"]
    assert "out" in refusal(words, capsys, case)


# --- Ctrl-C --------------------------------------------------------------------------------------


_INTERRUPTING = """\
import sympy as sm
from undertow import Parameter, Wrench
class Pull(Wrench):
    '''Constant pull.'''
    id = "pull"
    family = "tether"
    X_pull = Parameter("N", "pull")
    reference = "none"
    def wrench(self, s):
        {}
        return sm.Matrix([self.X_pull, 0, 0, 0, 0, 0])
"""


@pytest.mark.parametrize(
    ("command", "outputs"),
    first_quick(
        [("diagnose", ["--json", "o.json", "--report", "o.html"]), ("diagnose", ["--apply", "o.toml"])]
    ),
)
def test_ctrl_c_in_the_middle(command: str, outputs: list[str], quick: Path, capsys: Capture) -> None:
    """It comes while an effect of the user's own is tried."""
    (quick / "own.py").write_text(_INTERRUPTING.format("raise KeyboardInterrupt"))
    before = contents(quick)
    words = [str(word) for word in [*_words(command), "--effects", "own.py", *outputs]]
    assert main(words) == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert contents(quick) == before


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (
            ["compare", "usv.toml", "train.csv", "--json", "o.json"],
            "undertow.identification.logs.opening.read_table",
        ),
        (["export", "c", "usv.toml", "--out", "out"], "undertow.codegen.spelling.plain_c"),
    ],
)
def test_ctrl_c_in_reading_and_writing(
    words: list[str], place: str, case: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(place, interrupted)
    before = contents(case)
    assert main(words) == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert {p for p in contents(case) if Path(p).is_file()} == {p for p in before if Path(p).is_file()}


@pytest.fixture
def usual_signals() -> Iterator[None]:
    """Python's own handling of signals, which another test in this process may have left changed."""
    numbers = signal.SIGINT, signal.SIGALRM
    before = [signal.getsignal(n) for n in numbers]
    for number, usual in zip(numbers, (signal.default_int_handler, signal.SIG_DFL), strict=True):
        signal.signal(number, usual)
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler if handler is not None else signal.SIG_DFL)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_is_heard_where_a_library_drops_it(
    capsys: pytest.CaptureFixture[str], usual_signals: None
) -> None:
    dropped = []
    last = time.monotonic() + 30.0

    def stubborn() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            dropped.append(1)
        while time.monotonic() < last:  # a failure must not go on for ever
            pass

    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGALRM)
    assert run(stubborn) == 130
    assert dropped
    assert capsys.readouterr().err == "interrupted\n"
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGALRM)) == before
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_what_tidies_up_after_ctrl_c_is_not_interrupted(
    capsys: pytest.CaptureFixture[str], usual_signals: None
) -> None:
    tidied = []

    def tidy() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            for _ in range(3):  # what is due comes while this waits
                signal.sigtimedwait([signal.SIGUSR1], 0.1)
            tidied.append(1)

    assert run(tidy) == 130
    assert tidied
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_real_ctrl_c_while_a_diagnosis_runs(quick: Path) -> None:
    case = quick
    (case / "own.py").write_text(_INTERRUPTING.format("print('searching', flush=True)"))
    code = (
        # Whoever began the tests in the background had SIGINT ignored, which a child inherits.
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import sys; from undertow.cli.main import main\n"
        "words = ['usv.toml', 'train.csv', '--effects', 'own.py', '--json', 'o', '--apply', 'o.toml']\n"
        "raise SystemExit(main(['diagnose', *words]))"
    )
    before = contents(case)
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, "-W", "error", "-c", code],
        cwd=case,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "searching\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    # Where it came while Python forked or compiled something, Python adds lines of its own.
    assert "interrupted" in err.splitlines(), f"ended with {process.returncode} and said {err!r}"
    assert "bug in undertow" not in err
    # Python ends by the signal itself where that came while it made a dataclass: 130 for a shell, too.
    assert process.returncode in (130, -signal.SIGINT)
    assert contents(case) == before


@pytest.mark.parametrize(
    "words",
    [
        ["diagnose", "usv.toml", "train.csv", "--apply", "new.toml"],
        ["fit", "usv.toml", "train.csv", "--out", "new.toml"],
        ["add", "ocean_current", "usv.toml", "train.csv", "--out", "new.toml"],
    ],
)
def test_a_vehicle_file_that_cannot_be_rewritten_is_refused_before_any_log_is_read(
    words: list[str], quick: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def parse(text: str) -> None:
        raise TOMLKitError("a knot in it")

    monkeypatch.setattr("undertow.model.saving.tomlkit.parse", parse)
    (quick / "train.csv").write_text("no log")
    assert main(words) == 2
    assert "usv.toml: cannot be edited (a knot in it)" in capsys.readouterr().err
    assert not (quick / "new.toml").exists()


def test_a_folder_that_cannot_hold_the_code_is_refused_before_any_log_is_read(
    quick: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (quick / "train.csv").write_text("no log")
    words = ["add", "ocean_current", "usv.toml", "train.csv", "--out", "new.toml", "--build", "usv.toml"]
    assert main(words) == 2
    assert "cannot write into 'usv.toml': 'usv.toml' is not a folder" in capsys.readouterr().err
