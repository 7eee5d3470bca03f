"""What the shape of a hull says of its parameters before any test."""

from .bodies import AddedMass, cylinder, ellipsoid, prolate_spheroid, sphere
from .matrices import moved, turned

__all__ = ["AddedMass", "cylinder", "ellipsoid", "moved", "prolate_spheroid", "sphere", "turned"]
