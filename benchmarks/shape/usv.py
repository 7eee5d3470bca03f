"""The hull of a small uncrewed surface vehicle, made by rule: 2.0 m long, a round bilge, a transom."""

from __future__ import annotations

import numpy as np

from undertow.shape.mesh import Mesh, repaired

LENGTH, BEAM, DEPTH = 2.0, 0.60, 0.40  # m
MASS, CG = 90.0, -0.02  # kg; centre of gravity under (+) the waterline, m


def usv_hull(stations: int = 25, around: int = 13) -> Mesh:
    """Sections are half superellipses under a flat deck; the keel rises to the bow; m, z down."""
    x = np.linspace(-LENGTH / 2, LENGTH / 2, stations)
    ahead = np.clip(x / (LENGTH / 2), 0.0, 1.0)
    half, keel = BEAM / 2 * np.sqrt(np.maximum(1 - ahead**2.5, 0.0)), DEPTH * (1 - 0.5 * ahead**3)
    angle = np.linspace(0.0, np.pi, around)
    y = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.7
    z = np.abs(np.sin(angle)) ** 0.7
    rings = np.stack([np.repeat(x, around), np.outer(half, y).ravel(), np.outer(keel, z).ravel()], axis=1)
    faces = []
    for k in range(stations - 1):
        for i in range(around):
            a, b = k * around + i, k * around + (i + 1) % around
            faces += [[a, b, a + around], [b, b + around, a + around]]
    stern = [[0, i + 1, i] for i in range(1, around - 1)]
    ends = np.array([*faces, *stern])
    return repaired(Mesh(rings, ends), "usv")[0]
