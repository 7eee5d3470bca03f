"""Hulls as closed surfaces of triangles: volume, centre, inertia, areas."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from undertow.typing import Array

Faces = NDArray[np.int64]
_STATIONS = 100


@dataclass(frozen=True)
class Mesh:
    """A closed surface of triangles that are seen counter-clockwise from outside.

    Attributes
    ----------
    vertices : (n, 3) array
        m, body axes (x forward, y to starboard, z down).
    faces : (k, 3) array of int
        Places of the corners among the vertices.
    """

    vertices: Array
    faces: Faces

    @cached_property
    def corners(self) -> Array:
        """Corners of each triangle, m, shape (k, 3 corners, 3)."""
        return self.vertices[self.faces]

    @cached_property
    def vector_areas(self) -> Array:
        """Outward normals times areas, m^2, shape (k, 3)."""
        a, b, c = self.corners.transpose(1, 0, 2)
        return np.cross(b - a, c - a) / 2

    @cached_property
    def areas(self) -> Array:
        """Areas, m^2, shape (k,)."""
        return np.asarray(np.linalg.norm(self.vector_areas, axis=1))

    @property
    def bounds(self) -> Array:
        """Least and greatest coordinates, m, shape (2, 3)."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extents(self) -> Array:
        """Length, beam and height, m, shape (3,)."""
        return np.asarray(np.ptp(self.vertices, axis=0))

    @cached_property
    def _middle(self) -> Array:
        return np.asarray(self.bounds.mean(axis=0))

    @cached_property
    def _tetrahedra(self) -> tuple[Array, Array]:
        """Corners of tetrahedra with their fourth corner in the middle, and six times their volumes."""
        corners = self.corners - self._middle
        return corners, np.linalg.det(corners)

    @property
    def volume(self) -> float:
        """Enclosed volume, m^3; negative where the triangles look inward."""
        return float(self._tetrahedra[1].sum()) / 6

    @property
    def centroid(self) -> Array:
        """Centre of the enclosed volume, m, shape (3,)."""
        corners, six = self._tetrahedra
        return np.asarray(self._middle + six @ corners.sum(axis=1) / six.sum() / 4)

    @property
    def inertia(self) -> Array:
        """Inertia tensor about the centroid for a density of one, m^5, shape (3, 3)."""
        corners, six = self._tetrahedra
        total = corners.sum(axis=1)
        squares = np.einsum("k,kpi,kpj->ij", six, corners, corners)
        second = (squares + np.einsum("k,ki,kj->ij", six, total, total)) / 120
        away = self.centroid - self._middle
        second -= self.volume * np.outer(away, away)
        return np.asarray(np.trace(second) * np.eye(3) - second)

    def widths(self, along: int, across: int) -> tuple[Array, Array]:
        """How wide the hull is at stations along an axis, seen along the third.

        Parameters
        ----------
        along, across : int
            Axis of the stations, and that of the width: 0, 1, 2 for x, y, z.

        Returns
        -------
        widths : (n,) array
            m; gaps between parts of a section are not counted.
        steps : (n,) array
            Length that each station stands for, m; stations are closer at the ends.
        """
        low, high = self.bounds[:, along]
        angles = (np.arange(_STATIONS) + 0.5) / _STATIONS * np.pi - np.pi / 2
        half = (high - low) / 2
        places = low + half + half * np.sin(angles)
        weights = np.cos(angles)
        found = [_covered(*self._cut(along, across, place)) for place in places]
        return np.array(found), weights / weights.sum() * (high - low)

    def projected_area(self, axis: int) -> float:
        """Area of the silhouette seen along an axis, m^2."""
        widths, steps = self.widths((axis + 1) % 3, (axis + 2) % 3)
        return float(widths @ steps)

    def _cut(self, along: int, across: int, place: float) -> tuple[Array, Array]:
        """Where the triangles that a plane cuts begin and end in it."""
        reach = self.corners[:, :, along]
        cut = (reach.min(axis=1) < place) & (reach.max(axis=1) > place)
        x, y = reach[cut], self.corners[cut][:, :, across]
        x_next, y_next = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
        crossed = (x < place) != (x_next < place)
        share = np.where(crossed, (place - x) / np.where(crossed, x_next - x, 1.0), 0.0)
        points = y + share * (y_next - y)
        return (
            np.where(crossed, points, np.inf).min(axis=1),
            np.where(crossed, points, -np.inf).max(axis=1),
        )

    def moved(self, by: ArrayLike) -> Mesh:
        """The same hull elsewhere."""
        return Mesh(self.vertices + np.asarray(by, dtype=float), self.faces)

    def turned(self, rotation: Array) -> Mesh:
        """The same hull in other axes; `rotation` takes components along the old into those along the new."""
        return Mesh(self.vertices @ rotation.T, self.faces)


def _covered(begins: Array, ends: Array) -> float:
    """Length of the union of intervals."""
    order = np.argsort(begins)
    begins, ends = begins[order], ends[order]
    reached = np.concatenate([[-np.inf], np.maximum.accumulate(ends)[:-1]]) if len(ends) else ends
    return float(np.maximum(ends - np.maximum(begins, reached), 0.0).sum())
