"""A mapping file in the making: what columns may be, what is not sure, and the text with its questions."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from .guess_frames import Axes
from .mapping import SCHEMA, LogMapping


@dataclass(frozen=True)
class Guess:
    """What a column may be: keys and values of its entry in the mapping file, and what is not sure."""

    column: str
    entry: Mapping[str, object]
    doubt: str = ""

    @property
    def channel(self) -> str:
        """The channel that it becomes."""
        return str(self.entry["channel"])

    @property
    def is_formula(self) -> bool:
        """Whether it is computed, from the columns that `column` lists."""
        return "expression" in self.entry

    def line(self) -> str:
        """The entry in TOML, after its question."""
        key, said = (self.channel, {"channel"}) if self.is_formula else (self.column, set())
        inside = ", ".join(f"{k} = {_toml(value)}" for k, value in self.entry.items() if k not in said)
        asked = f"# ? {self.doubt}\n" if self.doubt else ""
        return f"{asked}{_key(key)} = {{ {inside} }}"


@dataclass(frozen=True)
class GuessedMapping:
    """A mapping file in the making.

    time: column, unit, and what was seen of the rate.
    questions: what nobody but those who made the log can say.
    ignored: columns that are left out, by the reason.
    reading: how the text of the table is written.
    """

    log: str
    time: Guess
    columns: tuple[Guess, ...]
    axes: Axes
    ignored: Mapping[str, tuple[str, ...]]
    reading: LogMapping = field(default_factory=LogMapping)
    questions: tuple[str, ...] = field(default=())

    @property
    def asked(self) -> list[str]:
        """All questions, those about columns with their names."""
        doubts: dict[str, list[str]] = {}
        for guess in (self.time, *self.columns):
            doubts.setdefault(guess.doubt, []).append(guess.column)
        of_columns = [f"{', '.join(names)}: {doubt}" for doubt, names in doubts.items() if doubt]
        return [*of_columns, *self.axes.questions, *self.questions]

    @property
    def meaning(self) -> LogMapping:
        """What the mapping file says."""
        return LogMapping.model_validate(tomllib.loads(self.text()))

    def text(self) -> str:
        """The mapping file."""
        head = [
            f"# Guessed from {self.log}: every line with '# ?' is a question that the log does not answer."
        ]
        head += [f"schema = {_toml(SCHEMA)}"]
        plain = LogMapping()
        head += [
            f"{key} = {_toml(getattr(self.reading, key))}"
            for key in ("delimiter", "not_numbers", "missing_commands")
            if getattr(self.reading, key) != getattr(plain, key)
        ]
        head += ["ignore = [", *(line for part in self._ignored() for line in part), "]"]
        time = [f"{key} = {_toml(value)}" for key, value in self.time.entry.items()]
        asked = [f"# ? {self.time.doubt}"] if self.time.doubt else []
        frames = [f"# ? {question}" for question in self.axes.questions]
        frames += [f"{key} = {_toml(value)}" for key, value in self.axes.entry.items()]
        formulas = [guess.line() for guess in self.columns if guess.is_formula]
        columns = [guess.line() for guess in self.columns if not guess.is_formula]
        columns += [f"# ? {q}" for q in self.questions]
        sections = {"time": [*asked, *time], "frames": frames, "columns": columns}
        sections |= {"channels": formulas} if formulas else {}
        parts = [f"[{name}]\n" + "\n".join(lines) for name, lines in sections.items()]
        return "\n\n".join(["\n".join(head), *parts]) + "\n"

    def _ignored(self) -> Iterator[list[str]]:
        for reason, names in self.ignored.items():
            yield [f"    # {reason}", *(f"    {_toml(name)}," for name in names)]


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _toml(name)
