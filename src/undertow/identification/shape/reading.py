"""Reading hulls from STL, OBJ and MSH files."""

from __future__ import annotations

import importlib
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from undertow.errors import UndertowError
from undertow.model.units import to_si
from undertow.typing import Array

from .capytaine import INSTALL
from .mending import mended
from .mesh import Faces, Mesh

_LARGEST_FILE = 300_000_000
_MOST_TRIANGLES = 1_000_000
_LONGEST, _SHORTEST = 100.0, 0.01
_LETTERS = {"F": (0, 1), "B": (0, -1), "R": (1, 1), "L": (1, -1), "D": (2, 1), "U": (2, -1)}
_STL_HEAD, _STL_FACET = 84, np.dtype([("floats", "<f4", 12), ("attribute", "<u2")])


@dataclass(frozen=True)
class Hull:
    """A hull out of a file.

    Attributes
    ----------
    mesh : Mesh
        Its surface in body axes.
    remarks : tuple of str
        What was mended, one line each.
    """

    mesh: Mesh
    remarks: tuple[str, ...]


def read_hull(path: str | Path, *, unit: str | None = None, frame: str = "FRD") -> Hull:
    """Read a closed hull from an STL (binary or text), OBJ or MSH file.

    Parameters
    ----------
    path : str or Path
        The file. MSH needs the extra `bem`.
    unit : str, optional
        What its numbers are in, such as "mm". Metres by default, and then a hull of more than 100 m or less
        than 1 cm is refused.
    frame : str
        Directions of its x, y and z axes: Forward or Back, Right or Left, Down or Up.

    Raises
    ------
    UndertowError
        If the file cannot be read, or the surface is open, several bodies, or of an unlikely size.
    """
    path = Path(path)
    vertices, faces = _content(path)
    if not len(faces):
        raise UndertowError(f"{path}: no triangles in it: export the surface of the hull as STL")
    if len(faces) > _MOST_TRIANGLES:
        raise UndertowError(
            f"{path}: {len(faces)} triangles are too many (limit {_MOST_TRIANGLES}): export it more coarsely"
        )
    if not np.isfinite(vertices).all():
        raise UndertowError(f"{path}: a coordinate is no finite number: export the hull anew")
    scaled = vertices * (1.0 if unit is None else _metres(unit))
    _check_size(path, scaled, unit)
    return Hull(*mended(Mesh(scaled @ _rotation(frame).T, faces), str(path)))


def _metres(unit: str) -> float:
    try:
        return to_si(f"1 {unit}", "m")
    except UndertowError as error:
        raise UndertowError(f"unit '{unit}' is no length: give m, mm, cm, in or ft") from error


def _rotation(frame: str) -> Array:
    """From the axes of a file to body axes."""
    rotation = np.zeros((3, 3))
    letters = [_LETTERS.get(letter, (0, 0)) for letter in frame.upper()]
    for column, (axis, sign) in enumerate(letters[:3]):
        rotation[axis, column] = sign
    if len(letters) != 3 or not np.isclose(np.linalg.det(rotation), 1.0):
        raise UndertowError(
            f"frame '{frame}' is no right-handed set of axes: say where x, y and z point, such as FRD "
            "(forward, right, down) or FLU (forward, left, up)"
        )
    return rotation


def _check_size(path: Path, vertices: Array, unit: str | None) -> None:
    extents = np.ptp(vertices, axis=0)
    longest = float(extents.max())
    if unit is None and not _SHORTEST <= longest <= _LONGEST:
        size = " x ".join(f"{e:.4g}" for e in extents)
        likely = "mm" if longest > _LONGEST else "in, ft or km"
        raise UndertowError(
            f"{path}: {size} m is no likely hull ({_SHORTEST:g} to {_LONGEST:g} m): say the unit of its "
            f"numbers, such as {likely} (or m if it is so)"
        )


def _content(path: Path) -> tuple[Array, Faces]:
    readers = {".stl": _stl, ".obj": _obj, ".msh": _msh}
    read = readers.get(path.suffix.lower())
    if read is None:
        raise UndertowError(f"{path}: hulls are read from .stl, .obj and .msh files: export it as STL")
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise UndertowError(f"{path}: larger than {_LARGEST_FILE / 1e6:g} MB: export it more coarsely")
        return read(path)
    except OSError as error:
        raise UndertowError(f"{path}: cannot be read: {error.strerror or error}") from error


# --- STL -----------------------------------------------------------------------------------------
def _stl(path: Path) -> tuple[Array, Faces]:
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= _STL_HEAD else -1
    binary = len(data) == _STL_HEAD + count * _STL_FACET.itemsize
    if not binary and not data[:512].lstrip().startswith(b"solid"):
        raise UndertowError(f"{path}: no STL file, or cut off: export the hull anew")
    points = _binary_facets(data) if binary else _text_facets(path, data)
    return points, np.arange(len(points)).reshape(-1, 3)


def _binary_facets(data: bytes) -> Array:
    facets = np.frombuffer(data, dtype=_STL_FACET, offset=_STL_HEAD)
    return facets["floats"][:, 3:].reshape(-1, 3).astype(float)


def _text_facets(path: Path, data: bytes) -> Array:
    words = [line.split() for line in data.splitlines()]
    points = [w[1:] for w in words if w and w[0].lower() == b"vertex"]
    try:
        found = np.array(points, dtype=float)
    except ValueError as error:
        raise UndertowError(f"{path}: a vertex is not three numbers: export the hull anew") from error
    if len(points) % 3 or (points and found.shape[1:] != (3,)):
        raise UndertowError(f"{path}: {len(points)} vertices do not make triangles: export the hull anew")
    return found.reshape(-1, 3)


# --- OBJ -----------------------------------------------------------------------------------------
def _obj(path: Path) -> tuple[Array, Faces]:
    lines = [line.split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    try:
        points, faces = _obj_content(lines)
    except (ValueError, OverflowError) as error:
        raise UndertowError(f"{path}: a line of it is not as OBJ has it ({error}): export anew") from error
    if faces.size and not (faces.min() >= 0 and faces.max() < len(points)):
        raise UndertowError(f"{path}: a face names a vertex that is not there: export the hull anew")
    return points, faces


def _obj_content(lines: list[list[str]]) -> tuple[Array, Faces]:
    points: list[list[str]] = []
    triangles: list[list[int]] = []
    for kind, *words in filter(None, lines):
        if kind == "v":
            points.append(words[:3])
        elif kind == "f":
            triangles += _fan([_place(corner, len(points)) for corner in words])
    return np.array(points, dtype=float).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _place(corner: str, before: int) -> int:
    """Place of a vertex: OBJ counts from one, or backwards from the last vertex before the face."""
    number = int(corner.split("/")[0])
    return before + number if number < 0 else number - 1


def _fan(polygon: list[int]) -> list[list[int]]:
    return [[polygon[0], b, c] for b, c in pairwise(polygon[1:])]


# --- MSH -----------------------------------------------------------------------------------------
def _msh(path: Path) -> tuple[Array, Faces]:
    try:
        meshio: Any = importlib.import_module("meshio")
    except ImportError as error:
        raise UndertowError(f"{path}: MSH files need meshio: {INSTALL}, or export the hull as STL") from error
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):  # it prints beside what it raises
            content = meshio.read(path)
    except (SystemExit, Exception) as error:  # meshio leaves the program where it cannot read a file
        raise UndertowError(f"{path}: meshio cannot read it ({error}): export the hull as STL") from error
    cells = [block.data for block in content.cells if block.type in ("triangle", "quad")]
    faces = [t for data in cells for polygon in data.tolist() for t in _fan(polygon)]
    return np.asarray(content.points, dtype=float), np.array(faces, dtype=np.int64).reshape(-1, 3)
