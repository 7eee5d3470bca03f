"""Added mass of simple bodies deep in ideal fluid, in closed form."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import elliprd

from undertow.errors import UndertowError
from undertow.typing import Array

from .matrices import transformation

_LAMB = "Lamb (1932), Hydrodynamics, chapter V (ellipsoids)"
#: Length over diameter from which strip theory counts for a cylinder across the flow.
_SLENDER = 5.0
# What flat ends change, by panels (docs/shape.md): shares of the strips times diameter over length, and what
# they carry along the axis over density times diameter cubed.
_ENDS_ACROSS, _ENDS_ABOUT, _ENDS_ALONG = 0.7, 2.0, 0.5


@dataclass(frozen=True)
class AddedMass:
    """Added mass of a body about its centre, far from bottom, walls and surface.

    Attributes
    ----------
    matrix : (6, 6) array
        kg, kg m and kg m^2 along the axes of the body; positive, so that X_udot of SNAME is minus its first
        entry.
    source : str
        Where the formula is from.
    limits : str
        Up to where it holds.
    error : (6, 6) array
        How far the numbers may be off in ideal fluid; zero for an exact formula.
    """

    matrix: Array
    source: str
    limits: str
    error: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def placed(self, rotation: ArrayLike, offset: ArrayLike) -> AddedMass:
        """The same body turned by `rotation` and with its origin at `offset`; see `transformation`."""
        T = transformation(rotation, offset)
        return replace(self, matrix=T @ self.matrix @ T.T, error=np.abs(T) @ self.error @ np.abs(T).T)


def ellipsoid(a: float, b: float, c: float, density: float = 1000.0) -> AddedMass:
    """Added mass of an ellipsoid.

    Parameters
    ----------
    a, b, c : float
        Semi-axes along x, y and z, m.
    density : float
        Of the fluid, kg/m^3.

    Raises
    ------
    UndertowError
        If a length or the density is not positive.

    Notes
    -----
    Lamb's integrals alpha_0, beta_0, gamma_0 are Carlson's R_D:
    alpha_0 = a b c ∫ dλ / ((a² + λ) Δ) = (2/3) a b c R_D(b², c², a²), and so on; their sum is 2.
    """
    positive(a=a, b=b, c=c, density=density)
    displaced = 4.0 / 3.0 * np.pi * density * a * b * c
    squares = np.array([a, b, c]) ** 2
    first = np.array([_integral(squares, i) for i in range(3)])
    linear = displaced * first / (2.0 - first)
    angular = [displaced / 5.0 * _rotation(squares, first, i) for i in range(3)]
    limits = "exact in ideal fluid without bottom, walls or surface"
    source = f"ellipsoid with semi-axes {a:g}, {b:g}, {c:g} m; {_LAMB}"
    return AddedMass(np.diag([*linear, *angular]), source, limits)


def sphere(radius: float, density: float = 1000.0) -> AddedMass:
    """Added mass of a sphere: half of what it displaces, in every direction."""
    positive(radius=radius)
    return ellipsoid(radius, radius, radius, density)


def prolate_spheroid(length: float, diameter: float, density: float = 1000.0) -> AddedMass:
    """Added mass of a spheroid that is long in x, from its length and greatest diameter in m."""
    positive(length=length, diameter=diameter)
    return ellipsoid(length / 2, diameter / 2, diameter / 2, density)


def cylinder(length: float, diameter: float, density: float = 1000.0) -> AddedMass:
    """Added mass of a slender circular cylinder along x, by strips: what the flow across it does.

    Parameters
    ----------
    length, diameter : float
        m; at least five diameters long.
    density : float
        Of the fluid, kg/m^3.

    Raises
    ------
    UndertowError
        If it is shorter, or a number is not positive.

    Notes
    -----
    Across, every slice of length dx carries density π d²/4 dx (Lamb 1932, chapter IV). Along its
    axis it is taken as zero: that depends on the ends, which strips do not see.
    """
    positive(length=length, diameter=diameter, density=density)
    if length < _SLENDER * diameter:
        raise UndertowError(
            f"a cylinder of {length:g} m by {diameter:g} m is {length / diameter:.3g} diameters long, strips "
            f"need {_SLENDER:g}: take the ellipsoid of the same length and volume, or a panel method"
        )
    across = density * np.pi / 4 * diameter**2 * length
    about = across * length**2 / 12
    slender = diameter / length
    limits = (
        f"from {_SLENDER:g} diameters of length; real ends take {_ENDS_ACROSS * slender:.0%} away across and "
        f"{_ENDS_ABOUT * slender:.0%} in turning, and there is some added mass along the axis, depending on "
        "their shape"
    )
    shares = np.array([0.0, _ENDS_ACROSS, _ENDS_ACROSS, 0.0, _ENDS_ABOUT, _ENDS_ABOUT]) * slender
    matrix = np.diag([0.0, across, across, 0.0, about, about])
    error = shares * matrix
    error[0, 0] = _ENDS_ALONG * density * diameter**3
    size = f"cylinder of {length:g} m by {diameter:g} m"
    source = f"{size}, strip theory; Lamb (1932), Hydrodynamics, chapter IV (circular cylinder)"
    return AddedMass(matrix, source, limits, error)


def _integral(squares: Array, i: int) -> float:
    j, k = ((i + 1) % 3, (i + 2) % 3)
    return float(2.0 / 3.0 * np.sqrt(squares.prod()) * elliprd(squares[j], squares[k], squares[i]))


def _rotation(squares: Array, first: Array, i: int) -> float:
    """Added moment of inertia about an axis over a fifth of the displaced mass."""
    j, k = (i + 1) % 3, (i + 2) % 3
    difference, total = squares[j] - squares[k], squares[j] + squares[k]
    if abs(difference) < 1e-12 * total:
        return 0.0  # a circle that turns about its middle moves no fluid
    apart = first[k] - first[j]
    return float(difference**2 * apart / (2.0 * difference - total * apart))


def positive(**numbers: float) -> None:
    """Refuse numbers that are not positive and finite, by their names."""
    for name, value in numbers.items():
        if not value > 0.0 or not np.isfinite(value):
            raise UndertowError(f"{name} = {value:g} must be a positive number")
