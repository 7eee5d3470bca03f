"""Files come from other people: nothing in them is executed, and names in them stay names."""

from __future__ import annotations

import ast
import html
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from benchmarks.hidden_effects import Case
from tests.cli.bad import LOG_COMMANDS, VEHICLE_COMMANDS, contents, each_once, refusal
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.codegen.compiler import Compiler
from undertow.codegen.library import Library
from undertow.model.loading import load_vehicle

Capture = pytest.CaptureFixture[str]
SOURCE = Path(__file__).parents[2] / "src" / "undertow"

# Each leaves a file behind where it is evaluated, run by a shell, or filled into a template.
PAYLOADS = {
    "expression": "__import__('pathlib').Path('owned').touch()",
    "attribute": "().__class__.__base__.__subclasses__()",
    "shell": "$(touch owned); touch owned; `touch owned`",
    "template": "{{ ''.__class__.__mro__ }}{% for x in () %}{% endfor %}${open('owned','w')}",
    "spreadsheet": "=cmd|'/c touch owned'!A1",
    "format": "{0.__class__.__init__.__globals__} %(x)s %n",
    "lambda": "(lambda: open('owned', 'w'))()",
}


def _words(command: str, vehicle: str = "evil.toml", log: str = "train.csv") -> list[str]:
    first = {"add": ["add", "constant_force"], "export": ["export", "c"]}.get(command, [command])
    return [*first, vehicle] if command == "export" else [*first, vehicle, log]


def _replaced(case: Path, old: str, new: str) -> None:
    text = (case / "usv.toml").read_text()
    assert old in text
    (case / "evil.toml").write_text(text.replace(old, new, 1))


# --- nothing is executed -------------------------------------------------------------------------

PLACES = {
    "value": ("m = 23.8", "m = {}"),
    "unit": ("m = 23.8", "m = {}"),
    "thruster": ('name = "f2"', "name = {}"),
    "effect": ("[effects.rigid_body]", "[effects.{}]"),
    "key": ("m = 23.8", "{} = 23.8"),
    "signs": ('signs = "sname"', "signs = {}"),
    "sigma": ("sigma = 0.282", "sigma = {}"),
    "limit": ("limit = 2.0", "limit = {}"),
    "channel": ('signs = "sname"', 'signs = "sname"\ngeneralised_forces = [{}]'),
}


@pytest.mark.parametrize(("place", "payload"), each_once(list(PLACES), PAYLOADS))
def test_code_in_a_vehicle_file_is_refused_as_what_it_is_not(
    place: str, payload: str, case: Path, capsys: Capture
) -> None:
    old, new = PLACES[place]
    text = f"3 {PAYLOADS[payload]}" if place == "unit" else PAYLOADS[payload]
    _replaced(case, old, new.format(json.dumps(text)))
    assert "evil.toml" in refusal(_words("compare"), capsys, case)


@pytest.mark.parametrize("payload", first_quick(PAYLOADS))
def test_code_in_free_text_of_a_vehicle_file_stays_text(payload: str, case: Path, capsys: Capture) -> None:
    text = json.dumps(PAYLOADS[payload])
    _replaced(case, 'name = "usv"', f"name = {text}\ndescription = {text}\nsource = {text}")
    evil = (case / "evil.toml").read_text()
    (case / "evil.toml").write_text(evil.replace('"guess, good to 15%"', text))
    for command in ("export", "compare"):
        assert main(_words(command)) == 0, capsys.readouterr().err
    assert main(["vehicles", "show", "evil.toml"]) == 0
    assert not (case / "owned").exists()


@pytest.mark.parametrize("payload", first_quick(PAYLOADS, 2))
def test_code_in_cells_and_headers_of_a_log_is_refused_or_ignored(
    payload: str, case: Path, simulated: Case, capsys: Capture
) -> None:
    columns: dict[str, object] = dict(simulated.runs["multisine"])
    text = PAYLOADS[payload]
    pl.DataFrame({**columns, text: [text] * 400}).write_csv(case / "extra.csv")
    assert main(_words("compare", "usv.toml", "extra.csv")) == 0  # a column of words that nobody asked for
    pl.DataFrame({**columns, "u": ["0.0"] * 399 + [text]}).write_csv(case / "cell.csv")
    assert "'u'" in refusal(_words("compare", "usv.toml", "cell.csv"), capsys, case)
    pl.DataFrame({**columns, "t": [text] * 400}).write_csv(case / "time.csv")
    assert "'t'" in refusal(_words("compare", "usv.toml", "time.csv"), capsys, case)
    assert not (case / "owned").exists()


@pytest.mark.parametrize(
    ("mapping", "payload"),
    each_once(
        [
            "[columns]\nf2 = {{ channel = {0} }}\n",
            '[columns]\nu = {{ channel = "u", unit = {0} }}\n',
            '[columns]\nu = {{ channel = "u", scale = {0} }}\n',
            "[time]\ncolumn = {0}\n",
            "[time]\nunit = {0}\n",
            "[frames]\nposition = {0}\n",
            "delimiter = {0}\n",
            "{0} = 1\n",
        ],
        PAYLOADS,
    ),
)
def test_code_in_a_mapping_file_is_refused(mapping: str, payload: str, case: Path, capsys: Capture) -> None:
    top = 'schema = "undertow/mapping/1"\n'
    (case / "map.toml").write_text(top + mapping.format(json.dumps(PAYLOADS[payload])))
    refusal([*_words("compare", "usv.toml"), "--map", "map.toml"], capsys, case)


def test_a_pickle_is_no_log(case: Path, capsys: Capture) -> None:
    (case / "evil.csv").write_bytes(b'cbuiltins\nexec\n(S\'open("owned", "w")\'\ntR.')
    np.save(case / "evil.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    for log in ("evil.csv", "evil.npy"):
        for command in LOG_COMMANDS:
            refusal(_words(command, "usv.toml", log), capsys, case)


_OWN = """\
import pathlib
pathlib.Path({!r}).touch()
import sympy as sm
from undertow import Parameter, Wrench
class Pull(Wrench):
    '''Constant pull.'''
    id = "pull"
    family = "tether"
    parameters = (Parameter("X_pull", "N", "pull"),)
    reference = "none"
    def wrench(self, s):
        return sm.Matrix([sm.Symbol("X_pull"), 0, 0, 0, 0, 0])
"""


@pytest.mark.parametrize("command", VEHICLE_COMMANDS)
def test_a_vehicle_file_cannot_have_its_effects_run(command: str, case: Path, capsys: Capture) -> None:
    (case / "own.py").write_text(_OWN.format(str(case / "owned")))
    _replaced(case, 'signs = "sname"', 'signs = "sname"\neffects_from = ["own.py"]')
    line = refusal(_words(command), capsys, case)
    assert "effects_from" in line
    assert "--effects own.py" in line


def test_nothing_beside_a_vehicle_file_is_imported(case: Path, capsys: Capture) -> None:
    for name in ("conftest", "sitecustomize", "usv", "evil", "numpy", "effects", "undertow"):
        (case / f"{name}.py").write_text(f"import pathlib\npathlib.Path({str(case / 'owned')!r}).touch()\n")
    shutil.copy(case / "usv.toml", case / "evil.toml")
    assert main(_words("compare")) == 0, capsys.readouterr().err
    assert not (case / "owned").exists()


# --- the source ----------------------------------------------------------------------------------

_MAY = {
    "exec_module": "model/catalogue.py",  # effect files that the user has named with --effects
    "spec_from_file_location": "model/catalogue.py",
    "lambdify": "model/composition.py",  # expressions of effects, never text
}
_READERS = {
    "eval",
    "exec",
    "compile",
    "__import__",
    "execfile",
    "lambdify",
    "parse_expr",
    "parse_latex",
    *_MAY,
}
_MODULES = {"yaml", "joblib", "code", "codeop", "runpy", "jsonpickle", "shelve", "imp"}


def _findings(tree: ast.Module, place: str) -> list[str]:
    nodes = list(ast.walk(tree))
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    found = [call for call in calls if _named(call) in _READERS and _MAY.get(_named(call)) != place]
    modules = [a.name for node in nodes if isinstance(node, ast.Import) for a in node.names]
    modules += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level]
    banned = [name for name in modules if name.partition(".")[0] in _MODULES]
    return [f"{place}:{call.lineno} {ast.unparse(call)[:60]}" for call in found] + banned


def _named(call: ast.Call) -> str:
    match call.func:
        case ast.Attribute(value=ast.Name(id="re"), attr="compile"):
            return "re.compile"
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return name
    return ""


def test_no_source_file_runs_text() -> None:
    named = re.compile(rf"\b({'|'.join(_READERS | _MODULES)})\b")  # others have nothing to be found
    texts = {path.relative_to(SOURCE).as_posix(): path.read_text() for path in SOURCE.rglob("*.py")}
    found = [
        finding
        for place, text in texts.items()
        if named.search(text.replace("re.compile(", ""))
        for finding in _findings(ast.parse(text), place)
    ]
    assert not found


@pytest.mark.parametrize(
    "code",
    [
        "compile(text, '', 'exec')",
        "__import__(name)",
        "sm.lambdify(x, text)",
        "import yaml",
        "from yaml import load",
    ],
)
def test_that_check_sees_what_it_should(code: str) -> None:
    assert _findings(ast.parse(code), "x.py")


# --- names in reports, on the terminal, in JSON and in vehicle files ------------------------------

EVIL = """<script>alert("1 & 2")</script><img src=x onerror='alert(3)'>"""
EVIL_LOG = "[bold]<script>alert(4)<script>&\"'[red].csv"


class _Page(HTMLParser):
    """Tags, attributes and text of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_data(self, data: str) -> None:
        self.text += data


def test_names_are_escaped_in_the_report_and_kept_everywhere(quick: Path, capsys: Capture) -> None:
    _replaced(quick, 'name = "hull"', f"name = {json.dumps(EVIL)}")
    shutil.copy(quick / "train.csv", quick / EVIL_LOG)
    words = ["diagnose", "evil.toml", EVIL_LOG]
    out = ["--json", "o.json", "--report", "o.html", "--apply", "o.toml"]
    assert main([*words, *out]) == 0, capsys.readouterr().err
    text = (quick / "o.html").read_text()
    page = _Page(text)
    assert not {"script", "img", "iframe", "object", "embed", "link"} & set(page.tags)
    assert not [name for name, _ in page.attributes if name.startswith("on")]
    assert EVIL in page.text
    assert html.escape(EVIL_LOG.removesuffix(".csv"), quote=False) in text.replace("&#34;", '"').replace(
        "&#39;", "'"
    )
    diagnosis = json.loads((quick / "o.json").read_text())
    assert diagnosis["vehicle"] == EVIL
    assert diagnosis["runs"][0]["name"] == EVIL_LOG.removesuffix(".csv")
    assert load_vehicle(quick / "o.toml").name == EVIL


def test_names_reach_the_terminal_as_they_are(case: Path, capsys: Capture) -> None:
    _replaced(case, 'name = "usv"', 'name = "[/bold] [red]not red[/red] {x}"')
    shutil.copy(case / "train.csv", case / EVIL_LOG)
    for command in ("compare", "fit"):
        assert main(_words(command, log=EVIL_LOG)) == 0, capsys.readouterr().err
    assert main(["vehicles", "show", "evil.toml"]) == 0
    assert "[/bold] [red]not red[/red] {x}" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["a\x1b[31mb", "a\nb", "a\x00b", "a\u202eb"])
def test_control_characters_are_no_part_of_a_name(name: str, case: Path, capsys: Capture) -> None:
    _replaced(case, 'name = "usv"', f"name = {json.dumps(name)}")
    assert "printable" in refusal(_words("export"), capsys, case)


@pytest.mark.slow
def test_pictures_of_logs_with_evil_names_stay_in_their_folder(case: Path, capsys: Capture) -> None:
    shutil.copy(case / "train.csv", case / "..;touch owned;.csv")
    before = contents(case)
    words = _words("compare", "usv.toml", "..;touch owned;.csv")
    assert main([*words, "--plots", "plots"]) == 0, capsys.readouterr().err
    new = [Path(path) for path in contents(case) if path not in before]
    assert all(path == case / "plots" or path.parent == case / "plots" for path in new)


# --- names in C ----------------------------------------------------------------------------------

C_NAMES = [
    "int",
    "double",
    "__attribute__",
    "while",
    "restrict",
    "main",
    "NAN",
    "x" * 40,
    "_Complex",
    "inline",
]


def _compiles(folder: Path, compiler: Compiler) -> None:
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]
    command = [*compiler.command, *strict, "-Isrc", *map(str, folder.resolve().rglob("*.c"))]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


REFUSED = ["f-1", "f 1", "1f", "x" * 41, "é", "", 'f"; int y;', "f*/", "u", "psi", "tau_X", "t"]


@pytest.mark.parametrize("name", first_quick(C_NAMES, 3))
def test_a_thruster_may_be_called_as_it_likes_in_c(
    name: str, case: Path, capsys: Capture, c_compiler: Compiler
) -> None:
    _replaced(case, 'name = "f2"', f'name = "{name}"')
    if not re.match("[A-Za-z]", name):  # names begin with a letter
        assert f"'{name}'" in refusal(_words("export"), capsys, case)
        return
    assert main([*_words("export"), "--out", "b"]) == 0, capsys.readouterr().err
    _compiles(case / "b" / "usv", c_compiler)


@pytest.mark.parametrize("name", first_quick(REFUSED, 4))
def test_a_thruster_with_no_name_or_a_taken_one_is_refused(name: str, case: Path, capsys: Capture) -> None:
    _replaced(case, 'name = "f2"', f"name = {json.dumps(name)}")
    for command in ("export", "compare"):
        line = refusal(_words(command), capsys, case)
        assert "evil.toml" in line
        assert name in line


@pytest.mark.parametrize(
    "name",
    first_quick(['a"; system("touch owned"); //', "*/ #error", "int", "double", "7", "main", "con"], 3),
)
def test_a_vehicle_may_be_called_as_it_likes_in_c(name: str, case: Path, c_compiler: Compiler) -> None:
    _replaced(case, 'name = "usv"', f"name = {json.dumps(name)}")
    folder = Library(load_vehicle(case / "evil.toml")).write(case / "b").folder
    assert folder.parent == case / "b"
    _compiles(folder, c_compiler)


def test_a_thruster_called_like_a_keyword_can_be_simulated(
    case: Path, simulated: Case, capsys: Capture
) -> None:
    _replaced(case, 'name = "f2"', 'name = "while"')
    log = pl.DataFrame(dict(simulated.runs["multisine"])).rename({"f2": "while"})
    log.write_csv(case / "while.csv")
    assert main(_words("compare", log="while.csv")) == 0, capsys.readouterr().err
