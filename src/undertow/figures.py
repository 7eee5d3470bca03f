"""The look of all pictures, and the way from a figure to SVG inside a page."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import floor, inf, log10
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from undertow.files import make_folder, write_whole

# From the palette of Okabe and Ito, which readers with any kind of colour vision can tell apart.
BEFORE = "#d55e00"
AFTER = "#1f86c4"
FLOOR = "#009e73"
# Stands for the colour of text; a page replaces it by its own, so that pictures suit a dark screen.
INK = "#1a1c1e"
FAINT = "#8a8f94"
# Lines that stand side by side.
COLOURS = (AFTER, BEFORE, FLOOR, "#cc79a7", "#e69f00", "#56b4e9")
WIDTH = 9.0
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LONGEST = 48
_DPI = 160

_RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.linewidth": 0.8,
    "axes.formatter.limits": (-3, 5),  # of a small vehicle 0.00025 and the like would run into each other
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": FAINT,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "svg.fonttype": "none",
    "svg.hashsalt": "undertow",
    "path.simplify_threshold": 0.2,
}


class Picture(Figure):
    """A figure that a notebook shows by itself, in the colour of its text."""

    def _repr_html_(self) -> str:
        return f'<div style="--ink: currentColor">{svg(self, f"figure{id(self)}")}</div>'


@contextmanager
def look() -> Iterator[None]:
    """Draw in the style of undertow; settings of the caller's own pictures come back afterwards."""
    with mpl.rc_context(_RC):
        yield


def figure(height: float, rows: int = 1, columns: int = 1, **kwargs: Any) -> tuple[Figure, Any]:
    """A figure of the usual width (inches) with a grid of axes, shape (rows, columns)."""
    result = Picture(figsize=(WIDTH, height), layout="constrained")
    return result, result.subplots(rows, columns, squeeze=False, **kwargs)


def spanning(axis: Any, least: float, which: str = "y") -> None:
    """Widen an axis to a least span, so that rounding errors of what rests do not look like motion."""
    low, high = axis.get_ylim() if which == "y" else axis.get_xlim()
    if high - low < least:
        middle = (low + high) / 2
        axis.set(**{f"{which}lim": (middle - least / 2, middle + least / 2)})


def plain(text: str, longest: int = _LONGEST) -> str:
    """A name from a file as a label: no line breaks, no formula, not too long."""
    shown = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    shown = shown if len(shown) <= longest else shown[: longest - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return shown.replace("$", r"\$")


def in_powers(largest: float, unit: str) -> tuple[float, str]:
    """What values are divided by, and their unit then, so that ticks have few digits: N or 1e6 N."""
    # Matplotlib would write the power at the end of the axis, across its label.
    if not 0.0 < largest < inf or 1e-2 <= largest < 1e4:
        return 1.0, unit
    power = 3 * floor(log10(largest) / 3)
    return 10.0**power, f"1e{power} {unit}"


def with_unit(name: str, unit: str) -> str:
    """Text of an axis: the quantity and its unit."""
    return f"{plain(name)} [{plain(unit_text(unit))}]" if unit not in ("", "1") else plain(name)


def unit_text(unit: str) -> str:
    """A unit for readers: ``"N/((m/s)^2)"`` gives ``"N/(m/s)²"``."""
    text = re.sub(r"\^(-?\d)", lambda m: m[1].translate(_SUPERSCRIPT), unit)
    # Parentheses around the whole denominator say nothing to a reader.
    return re.sub(r"/\((\([^()]*\)[²³]|[^()/ ]+)\)$", r"/\1", text)


def save_png(picture: Figure, path: Path) -> None:
    """Write a picture with a white background."""
    stream = io.BytesIO()
    with _quietly():
        picture.savefig(stream, format="png", dpi=_DPI, facecolor="white")
    write_whole(path, stream.getvalue())


def save_pictures(drawn: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write pictures into a folder, which is made, each under its name; the paths."""
    make_folder(folder)
    places = [folder / f"{name}.png" for name in drawn]
    for place, picture in zip(places, drawn.values(), strict=True):
        save_png(picture, place)
    return places


def svg(picture: Figure, prefix: str) -> str:
    """A picture as an ``<svg>`` element for a page: no links, its ids its own, text in the page's colour.

    `prefix` is letters and digits that no other picture of the page has.
    """
    stream = io.StringIO()
    with _quietly():
        picture.savefig(stream, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>\s*", "", text, flags=re.DOTALL)
    text = text.replace(' xmlns:xlink="http://www.w3.org/1999/xlink"', "").replace("xlink:href=", "href=")
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'\bhref="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    text = re.sub(r'\bd="[^"]*"', lambda m: re.sub(r"(\.\d)\d+", r"\1", m[0]), text)
    text = re.sub(r"font-family: [^;\"]*; ", "", text)
    return text.replace(INK, "var(--ink)").strip()


@contextmanager
def _quietly() -> Iterator[None]:
    """A name in letters that matplotlib's font lacks is drawn by the browser all the same."""
    with look(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph \d+ .*missing from font")
        yield
