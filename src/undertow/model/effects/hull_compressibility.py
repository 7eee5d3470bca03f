"""Buoyancy that changes with depth."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench
from undertow.model.symbols import rotation


class HullCompressibility(Wrench):
    """Buoyancy that falls with depth as the hull is compressed (or rises: stiff hull, denser water below).

    Included because a vehicle trimmed at one depth is light above and heavy below. The change per metre acts
    through the body origin; weight and buoyancy are equal at the depth -B_surface / B_depth. The excess at
    the surface alone is not compressibility but `net_buoyancy`.
    """

    id = "hull_compressibility"
    family = "statics"
    reference = "Fossen (2021), chapter 4 (buoyancy rho g V), V linear in the pressure by Hooke's law"
    signature = "the vertical command that holds depth changes steadily with the depth"

    B_depth = Parameter(
        "N/m", "change of the buoyancy per metre of depth, negative if the hull is compressed"
    )
    B_surface = Parameter("N", "buoyancy minus weight at the surface, in addition to the model", alone=False)

    def wrench(self, s: Signals) -> sm.Matrix:
        excess = self.B_surface + self.B_depth * s.eta[2]
        upward = rotation(sm.Matrix(s.eta[3:])).T * sm.Matrix([0, 0, -excess])
        return sm.Matrix([*upward, 0, 0, 0])
