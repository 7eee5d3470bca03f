"""The text of docs/shape.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from undertow import __version__
from undertow.identification.report.page import versions
from undertow.shape.mesh import load_capytaine

from .bodies import Measured

_TEXT = Path(__file__).parent / "page.md"
_NAMES = ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")
# What is smaller than this part of the largest of its kind is zero by symmetry.
_ZERO = 0.02


def page(measured: Sequence[Measured], finest: int) -> str:
    """The whole page.

    Parameters
    ----------
    measured : sequence of Measured
        Bodies by both ways.
    finest : int
        Most panels of the finest meshes.
    """
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    made = (
        "## How it was made\n\n"
        f"    python -m benchmarks.shape --panels {finest}\n\n"
        f"undertow {__version__}; capytaine {load_capytaine().__version__}; {used}.\n"
    )
    text = _TEXT.read_text(encoding="utf-8")
    return text.replace("{table}", "\n".join(_table(measured))).replace("{made}", made)


def _table(measured: Sequence[Measured]) -> Iterator[str]:
    yield f"| way | body | {' | '.join(_NAMES)} | panels |"
    yield f"|{'---|' * (3 + len(_NAMES))}"
    for m in measured:
        cells = " | ".join(_off(m, i) for i in range(6))
        stated = max(m.error[i] / m.panels[i] for i in range(6) if _is_there(m, i))
        yield f"| {m.group} | {m.body} | {cells} | {stated:.1%} |"


def _off(m: Measured, i: int) -> str:
    if not _is_there(m, i):
        return "some" if m.simple[i] > _ZERO * _largest(m, i) else "·"
    return f"{100 * (m.simple[i] / m.panels[i] - 1):+.1f}%"


def _is_there(m: Measured, i: int) -> bool:
    """Whether the panels find added mass that is none of rounding."""
    size = float(m.panels[:3].max()) ** (5 / 3) / 1000.0 ** (2 / 3)  # inertia of that mass of water, about
    least = _ZERO**2 * size if i > 2 else 0.0
    return bool(m.panels[i] > max(_ZERO * _largest(m, i), least))


def _largest(m: Measured, i: int) -> float:
    kind = slice(3 * (i // 3), 3 * (i // 3) + 3)
    return float(m.panels[kind].max())
