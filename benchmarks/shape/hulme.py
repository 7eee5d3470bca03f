"""Added mass and radiation damping of a floating half-sphere, as published.

Source: Hulme (1982), The wave forces acting on a floating hemisphere undergoing forced periodic oscillations,
J. Fluid Mech. 121, 443-463, tables 1 and 2: by k a (wave number times radius), over the displaced mass, the
damping over displaced mass and frequency.
"""

from __future__ import annotations

ADDED = {
    "surge": {0.1: 0.5223, 0.2: 0.5515, 0.4: 0.6175, 0.6: 0.6586, 1.0: 0.5740, 1.4: 0.4038, 2.0: 0.2493,
              3.0: 0.1720, 4.0: 0.1620, 5.0: 0.1679},
    "heave": {0.1: 0.8627, 0.2: 0.7938, 0.4: 0.6452, 0.6: 0.5381, 1.0: 0.4284, 1.4: 0.3924, 2.0: 0.3884,
              3.0: 0.4111, 4.0: 0.4322, 5.0: 0.4471},
}  # fmt: skip
DAMPING = {
    "surge": {0.1: 0.0010, 0.2: 0.0082, 0.4: 0.0557, 0.6: 0.1516, 1.0: 0.3535, 1.4: 0.4060},
    "heave": {0.1: 0.1816, 0.2: 0.2793, 0.4: 0.3410, 0.6: 0.3271, 1.0: 0.2484, 1.4: 0.1756, 2.0: 0.1031,
              2.5: 0.0674, 3.0: 0.0452, 4.0: 0.0219, 5.0: 0.0116},
}  # fmt: skip
