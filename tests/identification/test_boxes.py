"""The table of boxes, against numbers known before it and against limits."""

from __future__ import annotations

import numpy as np
import pytest

from undertow.errors import UndertowError
from undertow.shape.bodies import _table, box  # the table is held against numbers

from .test_panels import BOX

RHO = 1000.0


def coefficients(*sides: float) -> np.ndarray:
    return np.diag(box(*sides).matrix) / RHO / np.prod(sides)


def test_the_projects_box() -> None:
    found = box(0.60, 0.42, 0.24)
    np.testing.assert_allclose(np.diag(found.matrix), BOX, rtol=0.01)
    assert np.all(np.abs(np.diag(found.matrix) - BOX) <= np.diag(found.error))
    np.testing.assert_array_equal(found.matrix, np.diag(np.diag(found.matrix)))
    assert "table" in found.source
    assert "within 2%" in found.limits


def test_sides_in_any_order_are_the_same_box() -> None:
    whole = np.diag(box(0.6, 0.4, 0.2).matrix)
    np.testing.assert_allclose(np.diag(box(0.2, 0.6, 0.4).matrix), whole[[2, 0, 1, 5, 3, 4]], rtol=1e-12)
    cube = np.diag(box(0.3, 0.3, 0.3).matrix)
    np.testing.assert_allclose(cube, np.repeat(cube[[0, 3]], 3), rtol=1e-4)


def test_it_scales_with_size_and_density() -> None:
    one, large = np.diag(box(0.6, 0.4, 0.2, 1000.0).matrix), np.diag(box(6.0, 4.0, 2.0, 1025.0).matrix)
    np.testing.assert_allclose(large / one / 1.025, [1e3] * 3 + [1e5] * 3, rtol=1e-12)


def test_a_long_square_bar_nears_its_section() -> None:
    """Across, a square section of side 2 a carries 4.754 rho a^2 per length (Newman 1977)."""
    section = 4.754 / 4
    across = [coefficients(length, 1.0, 1.0)[1] for length in (1.0, 2.0, 4.0, 5.6)]
    assert all(np.diff(across) > 0)
    assert across[-1] < section
    # What is missing goes with the diameter over the length.
    assert across[-1] + (across[-1] - across[-2]) * 4.0 / 1.6 == pytest.approx(section, rel=0.03)


def test_a_plate_nears_a_thin_disc() -> None:
    """Flat on, a disc of area A carries 8/3 rho r^3; a square plate some tenth more than that of its area."""
    side, thin = 1.0, 1.0 / 5.6
    disc = 8 / 3 * (side**2 / np.pi) ** 1.5
    plate = coefficients(side, side, thin)[2] * side**2 * thin
    assert 1.0 < plate / disc < 1.3


def test_between_two_boxes_of_the_table() -> None:
    """Leaving out every other line, the spline through the rest meets those left out."""
    from scipy.interpolate import RectBivariateSpline

    ratios, values = _table()
    places = np.log(ratios)
    rest = [0, 1, 3, 5]
    for i in range(6):
        coarse = RectBivariateSpline(places[rest], places[rest], np.log(values[np.ix_(rest, rest)][..., i]))
        # With half the spacing a cubic is some sixteen times better: 0.4%.
        np.testing.assert_allclose(
            coarse(places[[2, 4]], places[[2, 4]]), np.log(values[[2, 4]][:, [2, 4], i]), atol=0.06
        )


@pytest.mark.parametrize("sides", [(6.0, 1.0, 1.0), (1.0, 1.0, 6.0), (10.0, 5.0, 0.5)])
def test_outside_of_the_table(sides: tuple[float, float, float]) -> None:
    with pytest.raises(UndertowError, match=r"has sides in the ratio \d+, the table ends at 5.66 between"):
        box(*sides)


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_sides_are_positive(wrong: float) -> None:
    with pytest.raises(UndertowError, match="must be a positive number"):
        box(1.0, wrong, 1.0)
