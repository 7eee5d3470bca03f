"""Equations as MathML in the page itself: browsers render it, and no script or network is needed."""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert
from sphinx.errors import ExtensionError


def _mathml(latex: str, display: str) -> str:
    try:
        return convert(latex, display=display)
    except Exception as error:  # the library has no base class of its own errors
        raise ExtensionError(f"equation cannot be converted to MathML: {latex!r}: {error}") from error


def _inline(writer: Any, node: Any) -> None:
    writer.body.append(_mathml(node.astext(), "inline"))


def _block(writer: Any, node: Any) -> None:
    writer.body.append(f'<div class="math-block">{_mathml(node.astext(), "block")}</div>')


def _visit_inline(writer: Any, node: Any) -> None:
    from docutils import nodes

    _inline(writer, node)
    raise nodes.SkipNode


def _visit_block(writer: Any, node: Any) -> None:
    from docutils import nodes

    _block(writer, node)
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, Any]:
    """Make `mathml` a choice of ``html_math_renderer``."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
