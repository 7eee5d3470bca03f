"""The page of the catalogue, written from the effects when the site is built; it is not kept in git."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from signature_picture import picture

from undertow.model.catalogue import catalogue
from undertow.model.describe import Description, Equation, ParameterNote, describe

PAGE = "catalogue.md"

_HEAD = """\
# Catalogue of effects

Every effect that undertow can put into a model, as its file declares it. Written from the code when this
site is built; `undertow effects show ID` prints the same. Forces and moments X, Y, Z, K, M, N act on the
vehicle in body axes; signs of parameters are those of SNAME. Thruster effects are shown for two thrusters,
*port* and *starboard*. To add one: [Write an effect](write-an-effect.md).

Each picture is drawn from the equations: the force or moment, the velocity of the water, what reaches the
thruster, or what the sensors report, over the variable that changes it most. Effects with memory or delay are
drawn over time, while one variable is switched on and off. The values of the parameters are chosen to show
the shape and belong to no vehicle. Variables that are not varied are zero, except u = 1 m/s and the command
of the port thruster, 1.
"""


def page() -> str:
    """The catalogue as MyST Markdown, by family."""
    described = sorted((describe(cls) for cls in catalogue().values()), key=lambda d: (d.family, d.id))
    parts = [_HEAD]
    for family, members in groupby(described, key=lambda d: d.family):
        parts += [f"## {family.capitalize()}\n", *(part for d in members for part in _effect(d))]
    return "\n".join(parts)


def _effect(d: Description) -> Iterator[str]:
    yield f"### {d.id}\n\n{d.about}\n"
    if d.details:
        yield f"{d.details}\n"
    yield from map(_equation, d.equations)
    if d.legend:
        yield "where\n\n" + "\n".join(f"- `{names}`: {what}" for names, what in d.legend.items()) + "\n"
    yield from _parameters(d)
    yield _picture(d.id)
    if d.signature:
        yield f"**In a log:** {d.signature}.\n"
    if d.requires:
        yield f"**Requires:** {_links(d.requires)}\n"
    if d.shares:
        yield f"**Uses, where the vehicle has them, the parameters of:** {_links(d.shares)}\n"
    if d.reference:
        yield f"**Reference:** {d.reference}\n"


def _equation(equation: Equation) -> str:
    return f"```{{math}}\n{equation.latex}\n```\n"


def _picture(effect_id: str) -> str:
    svg, values = picture(catalogue()[effect_id])
    shape = f"<figcaption>Drawn with {escape(values)}.</figcaption>" if values else ""
    head = f'<figure class="signature" aria-label="Signature of {effect_id}">'
    return f"```{{raw}} html\n{head}{svg}{shape}</figure>\n```\n"


def _links(ids: tuple[str, ...]) -> str:
    return ", ".join(f"[{i}](#{i})" for i in ids)


def _parameters(d: Description) -> Iterator[str]:
    if d.parameters:
        head = "| parameter | unit | from | to | | meaning |\n|---|---|---|---|---|---|"
        yield "\n".join([head, *map(_row, d.parameters), ""])
    if d.from_logs:
        listed = "\n".join(f"- `{name}`: {about}" for name, about in d.from_logs.items())
        yield f"A log may hold (`inputs` of the vehicle file):\n\n{listed}\n"
    if d.also_in_files:
        also = ", ".join(f"`{name}` ({unit})" for name, unit in d.also_in_files.items())
        yield f"A vehicle file may give these instead: {also}.\n"


def _row(p: ParameterNote) -> str:
    low, high = ("" if x is None else f"{x:.4g}" for x in (p.low, p.high))
    kind = ("linear" if p.linear else "shape") + (", per run" if p.per_run else "")
    kind += ", required" if p.required else ""
    return f"| `{p.name}` | {p.unit} | {low} | {high} | {kind} | {p.about.replace('|', chr(92) + '|')} |"


def _write(app: Any) -> None:
    path, text = Path(app.srcdir) / PAGE, page()
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, Any]:
    """Write the page before Sphinx looks for sources."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
