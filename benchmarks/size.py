"""How large the package is: lines, modules, packages, and how many modules a journey passes.

python -m benchmarks.size               # the working tree
python -m benchmarks.size main HEAD~3   # beside other revisions
python -m benchmarks.size --trace       # also what a diagnosis and a check of gains really enter (a minute)
"""

from __future__ import annotations

import ast
import io
import os
import subprocess
import sys
import tarfile
import tempfile
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
SMALL, MANY = 60, 25
# One file for each effect: what the budgets of packages and journeys leave out.
EFFECTS = "undertow.model.effects"
# What begins a journey and what ends it; then the command, which brings options, printing, the report, the
# doctor, long logs, and a plan for the next manoeuvre.
JOURNEYS = {
    "a log column to its verdict": (
        "undertow.identification.logs.reading",
        "undertow.identification.diagnosis.verdict",
    ),
    "a log column to all that `diagnose` prints": ("undertow.cli.identification.diagnose",),
    "a gain to its conditions": ("undertow.control.conditions.check",),
    "a gain to all that `gains` prints": ("undertow.cli.control.gains",),
}
_REACHED = """
import sys
import grimp
graph = grimp.build_graph("undertow", exclude_type_checking_imports=True, cache_dir=None)
for places in sys.argv[1:]:
    print(*{module for place in places.split() for module in (place, *graph.find_upstream_modules(place))})
"""
_ENTERED = """
import os, sys, threading
os.environ["UNDERTOW_JOBS"] = "1"
from undertow.cli.main import main
root = os.path.dirname(sys.modules["undertow"].__file__)
entered = set()
def record(frame, event, argument):
    if event == "call":
        entered.add(frame.f_code)
sys.setprofile(record)
threading.setprofile(record)
main(sys.argv[1:])
sys.setprofile(None)
ours = {c for c in entered if c.co_filename.startswith(root) and c.co_name != "<module>"}
ours = {c for c in ours if os.path.join("model", "effects", "") not in c.co_filename}
print(len({c.co_filename for c in ours}), len(ours))
"""
_SOURCES = {".py", ".c", ".h"}
_NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def code_lines(text: str) -> int:
    """Lines of Python that are neither blank, nor comment, nor docstring."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    lines = {n for t in tokens if t.type not in _NO_CODE for n in range(t.start[0], t.end[0] + 1)}
    return len(lines - _docstring_lines(ast.parse(text)))


def _docstring_lines(tree: ast.Module) -> set[int]:
    found: set[int] = set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and ast.get_docstring(node) is not None
        ):
            found.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return found


def _c_lines(text: str) -> int:
    """Lines of C that are neither blank nor wholly a `//` comment, or inside a block comment."""
    count, inside = 0, False
    for line in map(str.strip, text.splitlines()):
        opens = line.startswith("/*")
        count += bool(line) and not (inside or opens or line.startswith("//"))
        inside = (inside or opens) and "*/" not in line
    return count


def measure(sources: Path) -> dict[str, int]:
    """Numbers of a folder `src` by their description."""
    texts = {p: p.read_text(encoding="utf-8") for p in sources.rglob("*") if p.suffix in _SOURCES}
    code = {p: code_lines(t) if p.suffix == ".py" else _c_lines(t) for p, t in texts.items()}
    modules = [p for p in texts if p.suffix == ".py"]
    rooms = Counter(p.parent for p in modules if not p.match("model/effects/*"))
    numbers = {
        "lines, C included": sum(len(t.splitlines()) for t in texts.values()),
        "lines of code": sum(code.values()),
        "modules": len(modules),
        f"modules under {SMALL} lines of code": sum(code[p] < SMALL for p in modules),
        "the same without effects and __init__": sum(
            code[p] < SMALL for p in modules if not p.match("model/effects/*") and p.stem != "__init__"
        ),
        f"packages of more than {MANY} modules": sum(n > MANY for n in rooms.values()),
        "modules of the largest package": max(rooms.values()),
    }
    return numbers | _hops(sources)


def _hops(sources: Path) -> dict[str, int]:
    """Modules that a command can reach through imports, late ones too; effects are not counted."""
    # In a process of its own: this one may have found another package of the name already.
    done = subprocess.run(
        [sys.executable, "-c", _REACHED, *map(" ".join, JOURNEYS.values())],
        env={**os.environ, "PYTHONPATH": str(sources)},
        check=True,
        capture_output=True,
        text=True,
    )
    reached = [line.split() for line in done.stdout.splitlines()]
    counts = (sum(not module.startswith(EFFECTS) for module in modules) for modules in reached)
    return {f"modules from {name}": count for name, count in zip(JOURNEYS, counts, strict=True)}


def entered(sources: Path) -> dict[str, int]:
    """Modules and functions that run between a command and its answer, by their description."""
    demo = sources / "undertow" / "demo_data" / "auv"
    logs = [str(demo / f"train_{i}.csv.gz") for i in (1, 2)]
    commands = {
        "a log column to a verdict": ["diagnose", str(demo / "vehicle.toml"), *logs],
        "a gain to its conditions": ["gains", "mini-auv", "paper-pid"],
    }
    numbers: dict[str, int] = {}
    for name, words in commands.items():
        done = subprocess.run(
            [sys.executable, "-c", _ENTERED, *words],
            env={**os.environ, "PYTHONPATH": str(sources)},
            check=True,
            capture_output=True,
            text=True,
        )
        modules, functions = map(int, done.stdout.split()[-2:])
        numbers |= {f"modules entered, {name}": modules, f"functions entered, {name}": functions}
    return numbers


def numbers_of(sources: Path, *, trace: bool) -> dict[str, int]:
    """All numbers of a folder `src`; with `trace` two commands are run for some of them."""
    return measure(sources) | (entered(sources) if trace else {})


def of_revision(revision: str, *, trace: bool) -> dict[str, int]:
    """The same numbers of a commit."""
    command = ["git", "archive", revision, "src"]
    archive = subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
        return numbers_of(Path(folder) / "src", trace=trace)


def main(arguments: list[str]) -> None:
    trace = "--trace" in arguments
    columns = {r: of_revision(r, trace=trace) for r in arguments if r != "--trace"}
    columns["now"] = numbers_of(ROOT / "src", trace=trace)
    wide = max(8, *map(len, columns))
    print(" " * 44, *(f"{name:>{wide}}" for name in columns))
    for row in columns["now"]:
        print(f"{row:44}", *(f"{numbers[row]:{wide}d}" for numbers in columns.values()))


if __name__ == "__main__":
    main(sys.argv[1:])
