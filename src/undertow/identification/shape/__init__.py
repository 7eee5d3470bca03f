"""What the shape of a hull says of its parameters before any test."""

from .bodies import AddedMass, cylinder, ellipsoid, prolate_spheroid, sphere
from .boxes import box
from .matrices import moved, transformation, turned

__all__ = [
    "AddedMass",
    "box",
    "cylinder",
    "ellipsoid",
    "moved",
    "prolate_spheroid",
    "sphere",
    "transformation",
    "turned",
]
