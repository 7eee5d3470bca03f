"""Added mass of simple bodies: limits that are known in closed form, and the integrals by quadrature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from undertow.errors import UndertowError
from undertow.shape.bodies import cylinder, ellipsoid, prolate_spheroid, sphere, transformed
from undertow.shape.hull_vehicle import entry

RHO = 1000.0


def test_a_sphere_carries_half_of_what_it_displaces() -> None:
    found = sphere(0.3).matrix
    np.testing.assert_allclose(np.diag(found)[:3], 2 / 3 * np.pi * RHO * 0.3**3, rtol=1e-12)
    np.testing.assert_array_equal(np.diag(found)[3:], 0.0)


def lamb(a: float, b: float, c: float) -> tuple[np.ndarray, np.ndarray]:
    """Added mass and moment of inertia over displaced mass, with Lamb's integrals by quadrature."""
    axes = np.array([a, b, c])

    def integral(i: int) -> float:
        def inner(s: float) -> float:  # lambda = s / (1 - s) takes the half line to an interval
            x = s / (1 - s)
            return float(1 / ((axes[i] ** 2 + x) * np.sqrt(np.prod(axes**2 + x))) / (1 - s) ** 2)

        return float(np.prod(axes) * quad(inner, 0.0, 1.0, epsabs=1e-13, limit=200)[0])

    alpha, beta, gamma = (integral(i) for i in range(3))
    assert alpha + beta + gamma == pytest.approx(2.0, abs=1e-9)
    linear = np.array([k / (2 - k) for k in (alpha, beta, gamma)])
    pairs = ((b, c, gamma - beta), (c, a, alpha - gamma), (a, b, beta - alpha))
    angular = [
        (p**2 - q**2) ** 2 * d / (2 * (p**2 - q**2) - (p**2 + q**2) * d) / 5 if p != q else 0.0
        for p, q, d in pairs
    ]
    return linear, np.array(angular)


@pytest.mark.parametrize("axes", [(3.0, 1.0, 1.0), (2.0, 1.5, 0.4), (0.5, 0.5, 1.5), (1.0, 0.1, 0.7)])
def test_ellipsoids_against_quadrature(axes: tuple[float, float, float]) -> None:
    displaced = 4 / 3 * np.pi * RHO * np.prod(axes)
    linear, angular = lamb(*axes)
    found = np.diag(ellipsoid(*axes).matrix) / displaced
    np.testing.assert_allclose(found[:3], linear, rtol=1e-8)
    np.testing.assert_allclose(found[3:], angular, rtol=1e-7, atol=1e-12)
    assert np.all(found[3:] >= 0.0)


def test_a_spheroid_three_times_as_long_as_thick() -> None:
    """Closed form of the prolate spheroid by its eccentricity, written out."""
    e = np.sqrt(1 - 1 / 9)
    log = np.log((1 + e) / (1 - e))
    alpha = 2 * (1 - e**2) / e**3 * (0.5 * log - e)
    beta = 1 / e**2 - (1 - e**2) / (2 * e**3) * log
    displaced = 4 / 3 * np.pi * RHO * 3.0
    found = prolate_spheroid(6.0, 2.0).matrix
    assert found[0, 0] == pytest.approx(displaced * alpha / (2 - alpha), rel=1e-12)
    assert found[1, 1] == found[2, 2] == pytest.approx(displaced * beta / (2 - beta), rel=1e-12)


def test_a_spheroid_of_lambs_table() -> None:
    """Length over thickness 2.99: 0.122 along and 0.803 across."""
    found = np.diag(prolate_spheroid(2.99, 1.0).matrix) / (np.pi / 6 * RHO * 2.99)
    assert found[:2] == pytest.approx([0.122, 0.803], abs=1e-3)


def test_a_thin_disc_carries_eight_thirds_of_its_radius_cubed() -> None:
    found = ellipsoid(1e-5, 0.5, 0.5).matrix
    assert found[0, 0] == pytest.approx(8 / 3 * RHO * 0.5**3, rel=1e-4)
    # Tumbling about a diameter: 16/45 rho r^5.
    assert found[4, 4] == pytest.approx(16 / 45 * RHO * 0.5**5, rel=1e-4)


def test_a_long_ellipsoid_across_the_flow_is_a_row_of_circles() -> None:
    found = prolate_spheroid(1000.0, 1.0).matrix
    displaced = np.pi / 6 * RHO * 1000.0
    assert found[1, 1] == pytest.approx(displaced, rel=1e-4)
    assert found[0, 0] < 1e-4 * displaced


def test_a_cylinder_by_strips() -> None:
    body = cylinder(2.0, 0.2)
    across = RHO * np.pi * 0.1**2 * 2.0
    np.testing.assert_allclose(np.diag(body.matrix), [0, across, across, 0, across / 3, across / 3])
    assert "5 diameters" in body.limits
    # Flat ends, by panels: 27.39 kg and 1.849 kg m^2 for 1.0 m by 0.2 m (docs/shape.md), 4.02 kg along.
    short = cylinder(1.0, 0.2)
    off = np.abs(np.diag(short.matrix) - [4.02, 27.39, 27.39, 0.0, 1.849, 1.849])
    assert np.all(off < 1.2 * np.diag(short.error) + 1e-9)
    with pytest.raises(UndertowError, match=r"is 4 diameters long, strips need 5: take the ellipsoid"):
        cylinder(0.8, 0.2)


def test_energy_does_not_depend_on_axes_or_origin() -> None:
    rng = np.random.default_rng(2)
    matrix = ellipsoid(1.0, 0.4, 0.3).matrix
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    R *= np.sign(np.linalg.det(R))
    v, omega, offset = rng.standard_normal((3, 3))
    own = np.concatenate([v, omega])
    energy = own @ matrix @ own
    in_new_axes = np.concatenate([R @ v, R @ omega])
    assert in_new_axes @ transformed(matrix, R) @ in_new_axes == pytest.approx(energy)
    # The old origin moves with v: the new one, from which it lies at `offset`, with v - omega x offset.
    at_new_origin = np.concatenate([v - np.cross(omega, offset), omega])
    assert at_new_origin @ transformed(matrix, np.eye(3), offset) @ at_new_origin == pytest.approx(energy)
    with pytest.raises(UndertowError, match="not a right-handed rotation"):
        transformed(matrix, np.diag([1.0, 1.0, -1.0]))


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_lengths_are_positive(wrong: float) -> None:
    with pytest.raises(UndertowError, match="must be a positive number"):
        ellipsoid(1.0, wrong, 1.0)


def test_what_rounding_leaves_of_an_added_mass_is_none() -> None:
    """A body of revolution whose middle is off its axis by 1e-18 m adds nothing in roll."""
    added = replace(ellipsoid(1.0, 0.2, 0.2), matrix=np.diag([2.0, 60.0, 60.0, 1.9e-34, 11.0, 11.0]))
    assert [entry(added, i, i) for i in range(6)] == [2.0, 60.0, 60.0, 0.0, 11.0, 11.0]
