"""A floating circular cylinder as WAMIT computed it.

Source: examples/BEMIO/WAMIT/Cylinder/cyl.out of WEC-Sim (Copyright 2014 National Renewable Energy Laboratory
and Sandia Corporation, Apache License 2.0): WAMIT 7.2, 1008 panels and 336 on the lid, in water of 3 m, which
these waves hardly feel. About the centre of the waterline, heading 0; added mass over density, damping over
density and frequency, amplitude of the excitation over density and gravity.
"""

from __future__ import annotations

from undertow.shape.mesh import Mesh

from .hulls import cylinder_mesh

RADIUS, DRAUGHT, VOLUME = 0.35, 0.63, 0.241762  # m, m, m^3
# By frequency, rad/s: surge, heave and pitch, each with added mass, damping and excitation.
WAMIT = {
    3.76: ((0.2259905, 0.06629867, 0.4297698), (0.07737342, 0.007881102, 0.1045508),
           (0.01885552, 0.003903474, 0.1043416)),
    5.28: ((0.1363330, 0.1348398, 0.4359851), (0.07895461, 0.001351551, 0.03073226),
           (0.01336740, 0.006054794, 0.09241731)),
    7.48: ((0.06619792, 0.06279400, 0.2101565), (0.08180115, 2.788544e-05, 0.003091813),
           (0.01154640, 0.001514629, 0.03262448)),
}  # fmt: skip


def cylinder_hull() -> Mesh:
    """The cylinder, upright, with 0.27 m of it above the water."""
    along_x = cylinder_mesh(DRAUGHT + 0.27, 2 * RADIUS, 48)
    return Mesh(along_x.vertices[:, [1, 2, 0]], along_x.faces)
