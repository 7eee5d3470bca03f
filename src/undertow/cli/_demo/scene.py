"""Where the demo tells its story: sentences and tables on the terminal and, with pictures, on a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, StrictUndefined
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from undertow.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.identification.diagnosis.diagnose import Outcome
    from undertow.identification.report import ReportData

DATA = Path(str(files("undertow") / "demo_data"))


def report_data_of(outcome: Outcome) -> ReportData:
    """What a report draws, without a compiler: for a minute of data compiling takes longer than it saves."""
    from undertow.identification.compare.comparison import compare
    from undertow.identification.report import report_data

    before = compare(outcome.before, outcome.test, compiled=False)
    after = compare(outcome.after, outcome.test, compiled=False) if outcome.diagnosis.effects else None
    return report_data(before, after, names=("refitted", " ".join(["with", *outcome.diagnosis.effects])))


@dataclass
class Part:
    """One part of the story, in the order in which it was told: (kind, content)."""

    title: str
    told: list[tuple[str, Any]] = field(default_factory=list)


class Scene:
    """Tells, and writes files into one folder.

    Parameters
    ----------
    folder : Path
        Where files go; it is made.
    console : Console, optional
        The terminal.
    """

    def __init__(self, folder: Path, console: Console | None = None) -> None:
        self.folder = folder
        self._console = console or Console(highlight=False)
        self._parts: list[Part] = []

    def title(self, text: str) -> None:
        """Begin a part."""
        self._parts.append(Part(text))
        self._console.print(f"\n[bold]{escape(text)}[/bold]")

    def say(self, text: str) -> None:
        """A plain sentence or two."""
        self._parts[-1].told.append(("text", text))
        self._console.print(escape(text))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table in words; the first column is its side."""
        self._parts[-1].told.append(("table", (head, rows)))
        table = Table()
        for i, name in enumerate(head):
            table.add_column(escape(name), justify="right" if i else "left")
        for row in rows:
            table.add_row(*map(escape, row))
        self._console.print(table)

    def picture(self, name: str, picture: Figure, what: str) -> None:
        """Write a picture (PNG) that the page shows."""
        from undertow.identification.report import save_png

        save_png(picture, self._place(name))
        self._parts[-1].told.append(("picture", (name, what)))

    def text(self, name: str, content: str, what: str) -> None:
        """Write a file that the page refers to."""
        write_whole(self._place(name), content)
        self.mention(name, what)

    def mention(self, name: str, what: str) -> None:
        """Refer to a file that has been written."""
        self._parts[-1].told.append(("file", (name, what)))

    def path(self, name: str) -> Path:
        """Where a file of this name goes."""
        return self._place(name)

    def end(self) -> None:
        """Write the page that has it all, and say where things are."""
        environment = Environment(
            autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
        )
        page = environment.from_string(_PAGE).render(parts=self._parts)
        write_whole(self._place("index.html"), page)
        self._console.print(
            f"\n[bold]All of this, with pictures: {escape(str(self.folder / 'index.html'))}[/bold]"
        )
        for name, what in self._written():
            place = escape(str(self.folder / name))
            self._console.print(f"  {place}  [dim]{escape(what)}[/dim]", soft_wrap=True)

    def _written(self) -> list[Any]:
        return [content for part in self._parts for kind, content in part.told if kind in ("file", "picture")]

    def _place(self, name: str) -> Path:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>undertow demo</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
       color: #1a1c1e; background: #fff; }
img { max-width: 100%; height: auto; }
figure { margin: 1.5rem 0; }
figcaption { color: #555; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { border-bottom: 1px solid #ccc; padding: .25rem .75rem; text-align: right; }
th:first-child, td:first-child { text-align: left; }
</style>
<h1>undertow demo</h1>
{% for part in parts %}
<h2>{{ part.title }}</h2>
{% for kind, content in part.told %}
{% if kind == "text" %}
<p>{{ content }}</p>
{% elif kind == "table" %}
<table>
<tr>{% for cell in content[0] %}<th>{{ cell }}</th>{% endfor %}</tr>
{% for row in content[1] %}
<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}
</table>
{% elif kind == "picture" %}
<figure><img src="{{ content[0] }}" alt="{{ content[1] }}"><figcaption>{{ content[1] }}</figcaption></figure>
{% else %}
<p><a href="{{ content[0] }}">{{ content[0] }}</a>: {{ content[1] }}</p>
{% endif %}
{% endfor %}
{% endfor %}
</html>
"""
