"""Added mass and radiation damping by panels, against closed forms."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from benchmarks.shape.hulls import SIDES, ball, box_mesh, spheroid_mesh
from undertow.errors import UndertowError
from undertow.shape.bodies import box, ellipsoid, transformed
from undertow.shape.mesh import Mesh, has_capytaine, load_capytaine
from undertow.shape.panels import PanelResult, added_mass_of_hull

needs_capytaine = pytest.mark.skipif(
    not has_capytaine(), reason="capytaine is not installed: pip install undertow[bem]"
)
RHO, G = 1000.0, 9.81
BOX = np.array([20.6, 32.2, 74.4, 0.48, 1.20, 0.64])
"""kg and kg m^2, of the project's box of 0.60 x 0.42 x 0.24 m: known before this code, by another mesh."""
LAST_DIGIT = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])


@pytest.fixture(scope="module")
def spheroid() -> PanelResult:
    """Three to one, drawn in 2048 triangles."""
    return added_mass_of_hull(spheroid_mesh(1.2, 0.4, 4), RHO)


@needs_capytaine
def test_a_spheroid_of_three_to_one_against_lamb(spheroid: PanelResult) -> None:
    lamb = np.diag(ellipsoid(0.6, 0.2, 0.2, RHO).matrix)
    found = np.diag(spheroid.added.matrix)
    moving = lamb > 0
    np.testing.assert_allclose(found[moving], lamb[moving], rtol=0.005)
    assert found[3] == pytest.approx(0.0, abs=0.005 * lamb[4])
    assert "direct method" in spheroid.added.source
    assert len(spheroid.panels) == 3


@needs_capytaine
def test_the_error_stated_is_none_too_small_and_says_something(spheroid: PanelResult) -> None:
    lamb = ellipsoid(0.6, 0.2, 0.2, RHO).matrix
    error = spheroid.added.error
    assert np.all(np.abs(spheroid.added.matrix - lamb)[:3, :3] <= error[:3, :3] + 1e-9)
    assert np.all(np.diag(error)[:3] < 0.03 * np.diag(lamb)[:3])


@pytest.mark.slow
@needs_capytaine
def test_a_box_from_twelve_triangles() -> None:
    """The printed numbers, to half of their last digit and 0.3% for the extrapolation of either."""
    found = added_mass_of_hull(box_mesh(), RHO, finest=3200).added
    assert np.all(np.abs(np.diag(found.matrix) - BOX) < LAST_DIGIT / 2 + 0.003 * BOX)
    # The table of boxes was computed by quite another mesh.
    table = box(*SIDES, RHO)
    assert np.all(np.abs(np.diag(found.matrix - table.matrix)) < np.diag(found.error))


@needs_capytaine
@pytest.mark.parametrize(("finest", "least"), [(320, 0.95), (640, 0.98)])
def test_a_cube_by_few_panels_keeps_its_edges(finest: int, least: float) -> None:
    """The table of boxes was computed by another mesh."""
    found = np.diag(added_mass_of_hull(box_mesh((1.0, 1.0, 1.0)), RHO, finest=finest).added.matrix)
    assert np.all(found[:3] / np.diag(box(1.0, 1.0, 1.0, RHO).matrix)[:3] > least)
    np.testing.assert_allclose(found[:3], np.diag(box(1.0, 1.0, 1.0, RHO).matrix)[:3], rtol=1 - least)


@needs_capytaine
def test_place_and_direction_of_a_hull_do_not_matter() -> None:
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    place = np.array([0.7, -0.3, 0.2])
    here = added_mass_of_hull(box_mesh(), RHO, finest=800).added.matrix
    turned = Mesh(box_mesh().vertices @ turn.T + place, box_mesh().faces)
    there = added_mass_of_hull(turned, RHO, finest=800).added.matrix
    # Equal edges are cut in another order, so that the panels are not quite the same.
    expected = transformed(here, turn, place)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.all(np.abs(there - expected) < 0.005 * scale)
    np.testing.assert_allclose(there, there.T, atol=1e-9)


@pytest.mark.slow
@needs_capytaine
def test_near_the_surface_a_sphere_carries_less_at_high_frequency() -> None:
    """Pressure is constant at the surface: image of the opposite sign to that behind a wall (Lamb)."""
    radius, depth = 0.1, 0.25
    mesh = Mesh(ball(3).vertices * radius, ball(3).faces)
    half = 2 / 3 * np.pi * RHO * radius**3
    deep, near = (added_mass_of_hull(mesh, RHO, depth=d, finest=800).added.matrix for d in (None, depth))
    ratio = np.diag(near)[:3] / np.diag(deep)[:3]
    cubed = (radius / depth) ** 3
    np.testing.assert_allclose(ratio, 1 - np.array([3 / 16, 3 / 16, 3 / 8]) * cubed, atol=0.002)
    np.testing.assert_allclose(np.diag(deep)[:3], half, rtol=0.02)


@pytest.mark.slow
@needs_capytaine
def test_radiation_damping_of_a_small_deep_sphere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Haskind's relation with the long-wave force (1 + 1/2) rho V times the acceleration of the water."""
    import capytaine

    small = {"tabulation_nr": 200, "tabulation_nz": 120, "tabulation_nb_integration_points": 251}
    waves = capytaine.Delhommeau  # its own table takes 20 s, once; this one is good to 0.1% here
    monkeypatch.setattr(
        capytaine, "Delhommeau", lambda **given: waves(**{**small, "tabulation_cache_dir": None, **given})
    )
    radius, depth, omega = 0.1, 0.3, 2.0
    mesh = Mesh(ball(2).vertices * radius, ball(2).faces)
    found = added_mass_of_hull(mesh, RHO, depth=depth, omegas=[omega], finest=800, crease=45.0)
    k = omega**2 / G
    volume = 4 / 3 * np.pi * radius**3
    heave = (1.5 * volume) ** 2 * RHO * k**3 * omega * np.exp(-2 * k * depth) / 2
    (radiation,) = found.radiation
    assert radiation.omega == omega
    expected = heave * np.array([0.5, 0.5, 1.0])
    np.testing.assert_allclose(np.diag(radiation.damping)[:3], expected, rtol=0.04)
    assert np.all(np.diag(radiation.error)[:3] < 0.1 * heave)


@needs_capytaine
@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"finest": 100}, "100 panels are out of reach"),
        ({"crease": float("nan")}, "crease = nan degrees is impossible: choose between 0 and 180"),
        ({"crease": 0.0}, "crease = 0 degrees is impossible"),
        ({"crease": 180.0}, "crease = 180 degrees is impossible"),
        ({"omegas": [1.0]}, "give the depth of the hull"),
        ({"omegas": [-1.0], "depth": 2.0}, "omega = -1 rad/s is impossible"),
        ({"depth": 0.1}, "would stand out of the water"),
        ({"depth": float("nan")}, "would stand out of the water"),
    ],
)
def test_what_cannot_be(asked: dict[str, object], message: str) -> None:
    with pytest.raises(UndertowError, match=message):
        added_mass_of_hull(box_mesh(), RHO, **asked)  # type: ignore[arg-type]


@needs_capytaine
def test_capytaine_does_not_speak_for_itself(caplog: pytest.LogCaptureFixture) -> None:
    import logging

    handlers = list(logging.getLogger().handlers)
    package = load_capytaine()
    assert logging.getLogger().handlers == handlers
    package.meshes.meshes.LOG.warning("not heard")
    assert not caplog.records


def test_without_capytaine_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "capytaine", None)
    with pytest.raises(UndertowError, match=r'is not installed .*: pip install "undertow\[bem\]"'):
        added_mass_of_hull(box_mesh())
