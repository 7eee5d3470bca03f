"""What one window shows, and the pieces that pages are put together from."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from nicegui import ui

from .bench import Bench
from .figures import number
from .session import FORCE


def _nothing() -> None:
    pass


@dataclass
class View:
    """What one window shows of the workbench that all windows share."""

    bench: Bench
    page: str = "log"
    log: int = 0
    channels: list[str] = field(default_factory=list)
    zoom: tuple[float, float] | None = None
    selected: tuple[float, float] | None = None
    cell: tuple[str, str] | None = None
    variable: str = ""
    run: int = 0
    curve: str = ""
    hovered: str = ""
    edits: dict[str, dict[str, Any]] = field(default_factory=dict)
    draw: Callable[[], None] = _nothing
    show_progress: Callable[[], None] = _nothing
    show_simulation: Callable[[], None] = _nothing

    def __post_init__(self) -> None:
        self._seen = self.bench.revision

    def look(self) -> None:
        """Draw anew what another window, or the work, has changed."""
        self.show_progress()
        if self._seen != self.bench.revision:
            self._seen = self.bench.revision
            self.draw()


def measure_words(measure: str) -> str:
    """What a measure of an error is."""
    if measure == FORCE:
        return "force, times the noise"
    return f"velocity, {measure}{'' if measure == 'free run' else ' ahead'}"


def shown(measure: str, error: float | None) -> str:
    """An error in its unit."""
    if error is None:
        return "diverges"
    return number(error) if measure == FORCE else f"{number(100 * error)}%"


def heading(text: str, about: str = "") -> None:
    """A title with a line that says what is below."""
    with ui.column().classes("gap-0"):
        ui.label(text).classes("text-lg font-medium")
        if about:
            ui.label(about).classes("text-sm text-grey-8")


def stale() -> None:
    """Say that what is shown is about something else."""
    words = "This result is older than the last change: press the button to update it."
    ui.label(words).classes("bg-amber-1 text-amber-900 px-2 rounded").mark("stale")


def lines(text: str) -> None:
    """Text of a file or a command, as it is."""
    style = "white-space: pre-wrap; overflow-wrap: anywhere; background: #f5f5f5; border-radius: 4px"
    ui.label(text).classes("font-mono text-xs px-2 py-1 w-full").style(style)


def equation(plain: str, picture: str | None) -> None:
    """An equation by the address of its picture, with its text for those who cannot see it; else the text."""
    if picture is None:
        lines(plain)
        return
    text = html.escape(plain, quote=True)
    ui.html(f'<img src="{picture}" alt="{text}" title="{text}" style="max-width: none">').style(
        "overflow-x: auto; width: 100%"
    ).mark("equation")


def action(text: str, view: View, task: str, *, flat: bool = False, **args: Any) -> Any:
    """A button that starts a task; it rests while another one is going on."""
    return button(text, view, lambda: view.bench.start(task, **args), f"do-{task}", flat=flat)


def button(text: str, view: View, do: Callable[[], None], mark: str, *, flat: bool = False) -> Any:
    """A button that changes the model or starts work; it rests while something is going on."""
    made = ui.button(text, on_click=do).mark(mark)
    made.props("dense no-caps padding='4px 12px'" + (" outline" if flat else ""))
    made.set_enabled(view.bench.work is None)
    return made
