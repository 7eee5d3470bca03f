"""Sphinx: the site opens from a folder, without a network; `make docs` builds it into docs/_build/html."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent / "src")]

import undertow  # noqa: E402

project = "undertow"
author = "the undertow authors"
copyright = author
release = version = undertow.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "numpydoc", "mathml", "catalogue_page"]
html_theme = "furo"
html_title = f"undertow {release}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
myst_heading_anchors = 4
# The tutorial has no stored outputs: what the site shows is what this version does.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
# Types of other packages have no page here (no inventories are fetched), so names of types need not be links.
autodoc_typehints = "signature"
exclude_patterns = ["_build", "README.md"]
numpydoc_show_class_members = False

# Code blocks of terminal sessions and of the reports are no language that Pygments knows.
highlight_language = "text"

_OUTWARD = re.compile(r"(?<!!)\[([^\]]*)\]\(((?:\.\./)+[^)#\s]*)(?:#[^)\s]*)?\)")


def _without_links_out(app: Any, name: str, source: list[str]) -> None:
    """Links to files outside docs/ (right on a forge and in a clone) become the path in the repository."""
    folder = (HERE / name).parent

    def shown(match: re.Match[str]) -> str:
        target = (folder / match[2]).resolve()
        if target.is_relative_to(HERE):
            return match[0]
        return f"`{target.relative_to(HERE.parent)}`"

    source[0] = _OUTWARD.sub(shown, source[0])


def _without_module_text(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """The docstring of the package is for those who edit it; the page of the API has its own words."""
    if what == "module":
        lines.clear()


def setup(app: Any) -> None:
    """Connect what happens to each page."""
    app.connect("source-read", _without_links_out)
    app.connect("autodoc-process-docstring", _without_module_text)
