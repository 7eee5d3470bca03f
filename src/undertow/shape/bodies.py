"""Added mass of simple bodies in closed form, of boxes by table, and matrices in other axes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline
from scipy.special import elliprd

from undertow.errors import UndertowError
from undertow.typing import Array

from .mesh import Mesh


def transformed(matrix: Array, rotation: ArrayLike, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """A 6 × 6 inertia or added-mass matrix in other axes, about another origin; see `transformation`."""
    T = transformation(rotation, offset)
    return T @ matrix @ T.T


def transformation(rotation: ArrayLike, offset: ArrayLike) -> Array:
    """What takes forces and moments of a body into those in other axes, about another origin, shape (6, 6).

    A matrix M of forces per motion becomes T M T^T, and its errors E at most |T| E |T|^T.

    `rotation` (3, 3): takes components along the axes of the body into components along the new ones;
    `offset` (3,): where the body's origin lies from the new one, m, along the new axes.

    The velocity of the old origin is nu_1 + nu_2 × offset: M' = H^T M H with H = [[I, S(offset)^T], [0, I]]
    (Fossen 2021, chapter 3, transformation between points).
    """
    R, place = np.asarray(rotation, dtype=float), np.asarray(offset, dtype=float)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=_VALID.rounding) or np.linalg.det(R) < 0:
        raise UndertowError("rotation is not a right-handed rotation matrix: its rows must be orthonormal")
    if place.shape != (3,):
        raise UndertowError(f"offset has shape {place.shape}: give x, y and z in m")
    x, y, z = place
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[R, np.zeros((3, 3))], [skew @ R, R]])


_LAMB = "Lamb (1932), Hydrodynamics, chapter V (ellipsoids)"


@dataclass(frozen=True)
class ValidityLimits:
    """Up to where closed forms and tables hold."""

    slender: float = 5.0  # length over diameter from which strip theory counts for a cylinder
    # flat ends, by panels (docs/shape.md): share of the strips times diameter over length
    ends_across: float = 0.7
    ends_about: float = 2.0  # the same in turning
    ends_along: float = 0.5  # what flat ends carry along the axis over density times diameter cubed
    box: float = 0.02  # largest relative error of the table of boxes, its interpolation included
    # share of the way from box to ellipsoid: cylinders and torpedoes, no cone (docs/shape.md)
    between: float = 0.25
    full: float = 0.99  # share of that way from which a hull is a box
    rounding: float = 1e-9  # of rotations, and of the difference of two sections of a circle, relative
    at_end: float = 1e-6  # share by which sides may exceed the table of boxes: rounding
    # relative error of an ellipsoid that was stretched because the table of boxes ends
    stretched: float = 0.4


_VALID = ValidityLimits()


@dataclass(frozen=True)
class AddedMass:
    """Added mass of a body about its centre, far from bottom, walls and surface."""

    # (6, 6): kg, kg m and kg m^2 along the axes of the body; positive, so that X_udot of SNAME is minus its
    # first entry
    matrix: Array
    source: str  # where the formula is from
    limits: str  # up to where it holds
    # (6, 6): how far the numbers may be off in ideal fluid; zero for an exact formula
    error: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def placed(self, rotation: ArrayLike, offset: ArrayLike) -> AddedMass:
        """The same body turned by `rotation` and with its origin at `offset`; see `transformation`."""
        T = transformation(rotation, offset)
        return replace(self, matrix=T @ self.matrix @ T.T, error=np.abs(T) @ self.error @ np.abs(T).T)


def ellipsoid(a: float, b: float, c: float, density: float = 1000.0) -> AddedMass:
    """Added mass of an ellipsoid.

    `a`, `b`, `c`: semi-axes along x, y and z, m; `density`: of the fluid, kg/m^3.

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

    `length`, `diameter`: m; at least five diameters long; `density`: of the fluid, kg/m^3.

    Across, every slice of length dx carries density π d²/4 dx (Lamb 1932, chapter IV). Along its
    axis it is taken as zero: that depends on the ends, which strips do not see.
    """
    positive(length=length, diameter=diameter, density=density)
    if length < _VALID.slender * diameter:
        raise UndertowError(
            f"a cylinder of {length:g} m by {diameter:g} m is {length / diameter:.3g} diameters long, strips "
            f"need {_VALID.slender:g}: take the ellipsoid of the same length and volume, or a panel method"
        )
    across = density * np.pi / 4 * diameter**2 * length
    about = across * length**2 / 12
    slender = diameter / length
    limits = (
        f"from {_VALID.slender:g} diameters of length; real ends take "
        f"{_VALID.ends_across * slender:.0%} away across and {_VALID.ends_about * slender:.0%} in turning, "
        "and there is some added mass along the axis, depending on their shape"
    )
    shares = (
        np.array([0.0, _VALID.ends_across, _VALID.ends_across, 0.0, _VALID.ends_about, _VALID.ends_about])
        * slender
    )
    matrix = np.diag([0.0, across, across, 0.0, about, about])
    error = shares * matrix
    error[0, 0] = _VALID.ends_along * density * diameter**3
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
    if abs(difference) < _VALID.rounding * total:
        return 0.0  # a circle that turns about its middle moves no fluid
    apart = first[k] - first[j]
    return float(difference**2 * apart / (2.0 * difference - total * apart))


def positive(**numbers: float) -> None:
    """Refuse numbers that are not positive and finite, by their names."""
    for name, value in numbers.items():
        if not value > 0.0 or not np.isfinite(value):
            raise UndertowError(f"{name} = {value:g} must be a positive number")


_MOTIONS = 6
_SOURCE = "table of 36 boxes computed by a panel method (capytaine, direct method), interpolated"
_LIMITS = (
    f"sharp edges, smooth closed sides; within {_VALID.box:.0%} in ideal fluid far from bottom and surface; "
    "water that separates at the edges in large motions is not in it"
)


def box(length: float, beam: float, height: float, density: float = 1000.0) -> AddedMass:
    """Added mass of a rectangular box about its centre.

    `length`, `beam`, `height`: sides along x, y and z, m; `density`: of the fluid, kg/m^3.

    Cubic splines of the logarithms of the coefficients over the logarithms of both ratios of sides.
    """
    positive(length=length, beam=beam, height=height, density=density)
    sides = np.array([length, beam, height])
    order = np.argsort(-sides, kind="stable")
    longest, middle, shortest = sides[order]
    ratios = np.array([longest / middle, middle / shortest])
    most = _table()[0][-1]
    if (ratios > most * (1 + _VALID.at_end)).any():
        raise UndertowError(
            f"a box of {length:g} x {beam:g} x {height:g} m has sides in the ratio {ratios.max():.3g}, the "
            f"table ends at {most:.3g} between one side and the next: take an ellipsoid, or a panel method"
        )
    coefficients = np.array([float(np.exp(s(*np.log(np.minimum(ratios, most)))[0, 0])) for s in _splines()])
    squares = sides**2
    scale = density * sides.prod() * np.concatenate([np.ones(3), (squares.sum() - squares) / 12])
    own = np.empty(_MOTIONS)
    own[order], own[order + 3] = coefficients[:3], coefficients[3:]
    matrix = np.diag(own * scale)
    source = f"box of {length:g} x {beam:g} x {height:g} m; {_SOURCE}"
    return AddedMass(matrix, source, _LIMITS, _VALID.box * matrix)


@cache
def _table() -> tuple[Array, Array]:
    """Ratios of the sides, and coefficients, shape (ratios, ratios, 6)."""
    text = (files("undertow.shape") / "box_table.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("#", "L/B"))]
    rows = np.array([[float(x) for x in line.split(",")] for line in lines])
    ratios = np.unique(rows[:, 0])
    return ratios, rows[:, 2 : 2 + _MOTIONS].reshape(len(ratios), len(ratios), _MOTIONS)


@cache
def _splines() -> tuple[RectBivariateSpline, ...]:
    ratios, values = _table()
    places = np.log(ratios)
    return tuple(RectBivariateSpline(places, places, np.log(values[..., i])) for i in range(_MOTIONS))


# --- simple bodies in place of a hull -------------------------------------------------------------
_FILL_OF_ELLIPSOID = np.pi / 6
_BODY_LIMITS = "simple bodies of the same extents in place of the hull, in ideal fluid"


def equivalent(mesh: Mesh, density: float = 1000.0, form: str | None = None) -> AddedMass:
    """Added mass of a box or an ellipsoid with the extents of a hull, about the origin of its mesh.

    `density`: of the water, kg/m^3.
    """
    length, beam, height = mesh.extents.tolist()
    fill = mesh.volume / (length * beam * height)
    round_ = ellipsoid(length / 2, beam / 2, height / 2, density).matrix
    try:
        full = box(length, beam, height, density).matrix
    except UndertowError:
        if form == "box":
            raise
        full = None
    between, error, text = _interpolated(round_, full, fill)
    chosen = {"box": full, "ellipsoid": round_}.get(form or "", between)
    assert chosen is not None
    extents = f"{length:.4g} x {beam:.4g} x {height:.4g} m"
    source = f"{form or text} of the extents of the hull, {extents}, of which it fills {fill:.0%}"
    error = np.maximum(error, np.abs(chosen - between))
    return AddedMass(chosen, source, _BODY_LIMITS, error).placed(np.eye(3), mesh.centroid)


def _interpolated(round_: Array, full: Array | None, fill: float) -> tuple[Array, Array, str]:
    """Added mass for a hull that fills so much of its bounding box, its error, and how it was found."""
    if full is None:
        stretched = round_ * max(1.0, fill / _FILL_OF_ELLIPSOID)
        return stretched, _VALID.stretched * stretched, "an ellipsoid, stretched to the volume,"
    share = float(np.clip((fill - _FILL_OF_ELLIPSOID) / (1 - _FILL_OF_ELLIPSOID), 0.0, 1.0))
    if share > _VALID.full:
        return full, _VALID.box * full, "box"
    text = f"{1 - share:.0%} ellipsoid and {share:.0%} box"
    return round_ + share * (full - round_), _VALID.between * np.abs(full - round_), text
