"""The command line itself: quick help, one line for every mistake, exit codes, progress, documentation."""

from __future__ import annotations

import errno
import io
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import undertow
import undertow.cli
from docs._ext.commands_page import page
from tests.quick import first_quick
from undertow.cli import _terminal  # the terminal that a test stands for
from undertow.cli.main import commands, load, main

ROOT = Path(__file__).parents[1]
SLOW = {
    "casadi", "control", "hypothesis", "jinja2", "matplotlib", "numpy", "pandas", "pint", "plotly",
    "polars", "pydantic", "rich", "scipy", "statsmodels", "sympy", "tomlkit",
}  # fmt: skip
MOST_MODULES = 220
"""`undertow --help` takes 150 modules on Python 3.11 (0.1 s); anything slow brings hundreds more."""

Added = Callable[[str, str], None]


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Added:
    """Adds a command: a file in a folder of commands, and nothing else."""
    monkeypatch.setattr(undertow.cli, "__path__", [*undertow.cli.__path__, str(tmp_path)])

    def add(name: str, code: str) -> None:
        (tmp_path / f"{name}.py").write_text(f'"""Does {name}.\n\n    kept   as it is\n"""\n{code}\n')
        monkeypatch.delitem(sys.modules, f"undertow.cli.{name}", raising=False)

    return add


def _function(name: str, body: str) -> str:
    return f"import errno\nfrom undertow.errors import UndertowError\ndef {name}(): {body}"


def _run(*words: str, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "undertow", *words]
    return subprocess.run(
        command, env=_environment(), stderr=subprocess.PIPE, text=True, check=False, **options
    )  # type: ignore[call-overload, no-any-return]


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT / "src")}


# help ------------------------------------------------------------------------------------------------------


def test_help_imports_nothing_slow() -> None:
    code = "import sys; from undertow.cli.main import main; assert main(['--help']) == 0; print(*sys.modules)"
    answer = subprocess.run(
        [sys.executable, "-c", code], env=_environment(), capture_output=True, text=True, check=True
    )
    modules = answer.stdout.splitlines()[-1].split()
    assert not {name.partition(".")[0] for name in modules} & SLOW
    assert len(modules) <= MOST_MODULES, f"{len(modules)} modules are imported for --help"


def _imported(code: str, words: str, folder: Path) -> set[str]:
    """Which modules Python has after a piece of code."""
    command = [sys.executable, "-c", f"import sys; {code}; print(); print(*sys.modules)", *words.split()]
    done = subprocess.run(command, cwd=folder, env=_environment(), capture_output=True, text=True, check=True)
    return {*done.stdout.splitlines()[-1].split()}


def test_help_of_no_command_imports_anything_slow(tmp_path: Path) -> None:
    code = "from undertow.cli.main import main; [main([word, '--help']) for word in sys.argv[1:]]"
    # Typer looks for pydantic by itself.
    assert not _imported(code, " ".join(commands()), tmp_path) & (SLOW - {"pydantic"})


AUV = ROOT / "src" / "undertow" / "demo_data" / "auv"
NO_PICTURES = {"control", "matplotlib", "plotly", "scipy.signal"}
NO_NUMBERS = {"casadi", "polars", "scipy.stats", *NO_PICTURES}


@pytest.mark.parametrize(
    ("words", "spared"),
    first_quick(
        [
            ("audit-tables", {"sympy", "numpy", "pint", *NO_NUMBERS}),
            (f"compare {AUV / 'vehicle.toml'} {AUV / 'train_1.csv.gz'}", NO_PICTURES),
            ("gains mini-auv paper-pd", {"plotly", "polars", "undertow.identification"}),
            ("effects", {"numpy", "scipy", "pint", *NO_NUMBERS}),
            ("simulate mini-auv paper-pd --to -1,1,1 --for 0.1", NO_NUMBERS - {"casadi"}),
            ("vehicles", {"numpy", "scipy", "pint", *NO_NUMBERS}),
            ("effects show lift", NO_NUMBERS),
            ("vehicles show mini-auv", NO_NUMBERS),
            ("audit mini-auv", NO_NUMBERS),
            ("added-mass sphere --diameter 0.3", {"pint", *NO_NUMBERS}),
            ("export c mini-auv", NO_NUMBERS - {"casadi"}),
            (f"doctor {AUV / 'vehicle.toml'} {AUV / 'train_1.csv.gz'}", NO_PICTURES),
            ("linearize mini-auv", {"polars", "plotly", "undertow.identification"}),
        ]
    ),
)
def test_a_command_spares_what_it_does_not_need(words: str, spared: set[str], tmp_path: Path) -> None:
    code = "from undertow.cli.main import main; assert main(sys.argv[1:]) in (0, 1)"
    assert not _imported(code, words, tmp_path) & spared


def test_help_lists_every_command_with_its_first_line(
    added: Added, capsys: pytest.CaptureFixture[str]
) -> None:
    added("zz_extra", "raise ImportError('help must not import this')")
    assert main(["--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for name, line in commands().items():
        assert line, f"the module of the command {name} has no docstring"
        assert f"{name} {line}" in text
    assert "zz-extra Does zz_extra." in text


def test_without_words_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert capsys.readouterr().out.startswith("Usage: undertow [OPTIONS] COMMAND [ARGS]...")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"undertow {undertow.__version__}\n"


def test_help_of_a_command_is_its_docstring(added: Added, capsys: pytest.CaptureFixture[str]) -> None:
    added("zz", _function("zz", "pass"))
    assert main(["zz", "--help"]) == 0
    text = capsys.readouterr().out
    assert "Usage: undertow zz [OPTIONS]" in text
    assert "kept   as it is" in text
    assert "completion" not in text


def test_a_module_with_an_app_is_a_command_with_sub_commands(
    added: Added, capsys: pytest.CaptureFixture[str]
) -> None:
    added("zz", "import typer\napp = typer.Typer()\n@app.command()\ndef deep(word: str): print('deep', word)")
    assert main(["zz", "deep", "down"]) == 0
    assert capsys.readouterr().out == "deep down\n"


# mistakes, interruptions, bugs -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "code", "line"),
    [
        ("raise UndertowError('m = -1 kg: at least 0')", 2, "error: m = -1 kg: at least 0"),
        ("raise KeyboardInterrupt", 130, "interrupted"),
        ("import typer; raise typer.Abort", 130, "interrupted"),
        ("raise OSError(errno.ENOSPC, 'No space left on device')", 2, "error: no space left on device"),
        ("open('/nowhere/log.csv')", 2, "error: '/nowhere/log.csv': no such file or directory"),
        ("raise EOFError", 130, "interrupted"),
        ("return 1", 1, ""),
        ("return 'an answer'", 0, ""),
        ("return True", 0, ""),
        ("import typer; raise typer.Exit(3)", 3, ""),
    ],
)
def test_how_a_command_ends(
    added: Added, capsys: pytest.CaptureFixture[str], body: str, code: int, line: str
) -> None:
    added("zz", _function("zz", body))
    assert main(["zz"]) == code
    assert capsys.readouterr().err.strip() == line


@pytest.mark.parametrize(
    ("words", "named", "path"),
    [
        (["zzz"], "'zzz'", "undertow"),
        (["zz", "--no"], "--no", "undertow zz"),
        (["zz", "a"], "a", "undertow zz"),
    ],
)
def test_a_wrong_word_is_reported_in_one_line(
    added: Added, capsys: pytest.CaptureFixture[str], words: list[str], named: str, path: str
) -> None:
    added("zz", _function("zz", "pass"))
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert named in line
    assert line.endswith(f"; see {path} --help")


def test_a_bug_shows_its_traceback_and_says_so(added: Added, capsys: pytest.CaptureFixture[str]) -> None:
    added("zz", _function("zz", "1 / 0"))
    assert main(["zz"]) == 1
    *_, error, last = capsys.readouterr().err.splitlines()
    assert error == "ZeroDivisionError: division by zero"
    assert last.startswith("This is a bug in undertow")


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_in_a_running_command(tmp_path: Path) -> None:
    (tmp_path / "zz.py").write_text(
        '"""Waits."""\nimport signal\ndef zz():\n    print("ready", flush=True)\n    signal.pause()\n'
    )
    code = (
        # Whoever began the tests in the background had SIGINT ignored, which a child inherits.
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
        f"import undertow.cli; undertow.cli.__path__.append({str(tmp_path)!r});"
        "from undertow.cli.main import main; raise SystemExit(main(['zz']))"
    )
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], env=_environment(), text=True, **pipes) as process:  # type: ignore[call-overload]
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert err == "interrupted\n"
    assert process.returncode == 130


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_behind_stdout() -> None:
    with open("/dev/full", "w") as full:
        done = _run("--version", stdout=full)
    assert done.stderr == f"error: {os.strerror(errno.ENOSPC).lower()}\n"
    assert done.returncode == 2


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_reader_that_goes_away_is_no_error() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = _run("--help", stdout=writer)
    os.close(writer)
    assert done.stderr == ""
    assert done.returncode == 1


def _program(
    words: str, closed: str = "", prelude: str = "import sys", **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the program in a shell that closes streams before."""
    code = f"{prelude}; from undertow.cli.main import main; raise SystemExit(main())"
    shell = f'exec "$0" -c "$1" {words} {closed}'
    command = ["/bin/sh", "-c", shell, sys.executable, code]
    env = {**_environment(), **environment}
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False)


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX")
@pytest.mark.parametrize("closed", first_quick([">&-", ">&- 2>&-", "<&- >&- 2>&-"]))
@pytest.mark.parametrize(
    ("words", "code"), first_quick([("--version", 0), ("effects show lift", 0), ("nothing", 2)], 3)
)
def test_streams_that_were_closed(closed: str, words: str, code: int) -> None:
    done = _program(words, closed)
    assert done.returncode == code
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == (code == 2 and "2>" not in closed)


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX")
def test_a_file_does_not_take_the_place_of_a_stream_that_was_closed(tmp_path: Path) -> None:
    path = tmp_path / "usv.json"
    code = f"f = open({str(path)!r}, 'w'); import os; os.write(1, b'astray'); f.write('whole')"
    (tmp_path / "zz.py").write_text(f'"""Writes."""\ndef zz():\n    {code}\n')
    prelude = f"import undertow.cli; undertow.cli.__path__.append('{tmp_path}')"
    assert _program("zz", "<&- >&-", prelude).returncode == 0
    assert path.read_text() == "whole"


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX")
def test_what_a_terminal_cannot_show_is_written_in_ascii(tmp_path: Path) -> None:
    text = "λmin(K_V) ≤ 2 m², Σ τ → 3° ± ½ │ 漢 \udcff"
    (tmp_path / "zz.py").write_text(f'"""Prints."""\ndef zz():\n    print({text!a})\n')
    prelude = f"import undertow.cli; undertow.cli.__path__.append('{tmp_path}')"
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii", "PYTHONCOERCECLOCALE": "0"}
    done = _program("zz", prelude=prelude, **plain)
    reported = "lambdamin(K_V) <= 2 m^2, Sigma tau -> 3 deg +/- 12 | \\u6f22 \\udcff\n"
    assert (done.returncode, done.stderr, done.stdout) == (0, "", reported)
    assert _program("zz", prelude=prelude, PYTHONUTF8="1").stdout == text.replace("\udcff", "\\udcff") + "\n"


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX")
def test_warnings_of_python_are_for_those_who_ask(tmp_path: Path) -> None:
    body = "import warnings; warnings.warn('overflow encountered', RuntimeWarning)"
    (tmp_path / "zz.py").write_text(f'"""Warns."""\ndef zz():\n    {body}\n')
    prelude = f"import undertow.cli; undertow.cli.__path__.append('{tmp_path}')"
    assert _program("zz", prelude=prelude).stderr == ""
    assert "overflow encountered" in _program("zz", prelude=prelude, PYTHONWARNINGS="default").stderr


# what is going on ------------------------------------------------------------------------------------------

_TALKING = "import logging; log = logging.getLogger('undertow.zz'); log.info('step'); log.warning('odd')"


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["zz"], "warning: odd\n"),
        (["-v", "zz"], "step\nwarning: odd\n"),
        (["zz", "--verbose"], "step\nwarning: odd\n"),
    ],
)
def test_verbose_says_what_is_going_on(
    added: Added, capsys: pytest.CaptureFixture[str], words: list[str], reported: str
) -> None:
    added("zz", _function("zz", _TALKING))
    before = logging.getLogger("undertow").level
    assert main(words) == 0
    logging.getLogger("undertow").setLevel(before)
    assert capsys.readouterr().err == reported


class _Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


class _Timer:
    """A timer that has run out as soon as it is started, or never."""

    runs_out = True

    def __init__(self, seconds: float, action: Callable[[], None]) -> None:
        assert seconds == _terminal.SETTINGS.delay == 2.0
        self.action = action

    def start(self) -> None:
        if self.runs_out:
            self.action()

    def cancel(self) -> None:
        pass


def _progress_on(screen: io.StringIO, monkeypatch: pytest.MonkeyPatch, runs_out: bool) -> str:
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(_terminal, "Timer", _Timer)
    monkeypatch.setattr(_Timer, "runs_out", runs_out)
    monkeypatch.setenv("TERM", "xterm")
    with _terminal.progress("fitting", total=4.0) as report:
        report(1.0, "run [3]")
        report(4.0, "")
    return screen.getvalue()


def test_long_work_on_a_terminal_has_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    text = _progress_on(_Screen(), monkeypatch, runs_out=True)
    assert "run [3]" in text
    assert "100%" in text


def test_short_work_prints_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _progress_on(_Screen(), monkeypatch, runs_out=False) == ""


def test_without_a_terminal_nothing_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _progress_on(io.StringIO(), monkeypatch, runs_out=True) == ""


# documentation and public names ----------------------------------------------------------------------------


def test_every_command_is_documented() -> None:
    text = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    missing = [name for name in commands() if f"## undertow {name}\n" not in text]
    assert not missing, f"not in docs/cli.md: {missing}; run: python docs/_ext/commands_page.py docs/cli.md"


def test_every_option_and_operand_says_what_it_means() -> None:
    silent = [
        f"{name} {parameter.name}" for name in commands() for parameter in _parameters(load(name))
        if not getattr(parameter, "help", "")
    ]  # fmt: skip
    assert not silent, f"without help: {silent}"


def _parameters(command: object) -> list[object]:
    inner = getattr(command, "commands", {}).values()
    own = [parameter for parameter in command.params if "--help" not in parameter.opts]  # type: ignore[attr-defined]
    return own + [parameter for one in inner for parameter in _parameters(one)]


def test_the_page_of_commands_is_up_to_date() -> None:
    text = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    assert text == page(), "docs/cli.md is out of date; run: python docs/_ext/commands_page.py docs/cli.md"


def test_the_page_shows_operands_options_and_sub_commands(added: Added) -> None:
    added(
        "zz",
        "import typer\nfrom typing import Annotated\nfrom pathlib import Path\napp = typer.Typer()\n"
        "@app.command()\ndef deep(\n"
        "    logs: Annotated[list[Path], typer.Argument(help='The logs.', metavar='LOG')],\n"
        "    json: Annotated[Path | None, typer.Option(help='Where | to.')] = None,\n"
        "    tries: Annotated[int, typer.Option(help='How often.')] = 3,\n"
        "    key: Annotated[str, typer.Option(help='Needed.')] = ...,\n"
        "):\n    'Goes deep.'\n"
        "@app.command()\ndef other(): 'Another.'\n",
    )
    text = page()
    assert "## undertow zz\n\nDoes zz.\n\n```\n    kept   as it is\n```" in text
    assert "### undertow zz deep\n\nGoes deep.\n\n```\nundertow zz deep [OPTIONS] LOG...\n```" in text
    assert "| `LOG` | The logs. | required |" in text
    assert "| `--json` | Where \\| to. |  |" in text
    assert "| `--tries` | How often. | `3` |" in text
    assert "### undertow zz other" in text


def test_public_names_are_there_and_listed() -> None:
    assert set(undertow.__all__) == set(dir(undertow))
    for name in undertow.__all__:
        assert getattr(undertow, name) is not None
    with pytest.raises(AttributeError, match="'undertow' has no attribute 'nothing'"):
        _ = undertow.nothing


def test_type_checkers_see_the_same_public_names() -> None:
    source = (ROOT / "src" / "undertow" / "__init__.py").read_text(encoding="utf-8")
    for name in set(undertow.__all__) - {"__version__"}:
        assert f"{name} as {name}" in source, f"import {name} under TYPE_CHECKING too"
