"""Units: numbers worked out by hand, clear refusals, and no computation asked for by a file."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from undertow.errors import UndertowError
from undertow.model.units import dimension, scale_offset, to_si


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("7.5 kg", "kg", 7.5),
        (" -16 cm ", "m", -0.16),
        ("0.251 kg m^2", "kg m^2", 0.251),
        ("3 knots", "m/s", 3 * 1852 / 3600),
        ("20 degC", "K", 293.15),
        ("180 deg", "rad", math.pi),
        ("60 rpm", "rad/s", 2 * math.pi),
        ("1 N/(m/s)^2", "kg/m", 1.0),
        ("2 N s²/m²", "kg/m", 2.0),
        ("5 Nm", "kg m^2/s^2", 5.0),
        ("1 lbf", "N", 4.4482216152605),
        ("4 1/s/m", "1/(m s)", 4.0),
        ("10%", "1", 0.1),
        ("0.9", "1", 0.9),
        ("1 N m s/deg", "N m s", 180 / math.pi),
        (1025, "kg/m^3", 1025.0),
    ],
)
def test_quantities_become_si(text, unit, expected):
    assert to_si(text, unit) == pytest.approx(expected, rel=1e-12)


def test_wrong_dimension_names_value_found_and_wanted():
    with pytest.raises(UndertowError, match=r"'7\.5 m' has the dimension \[length\], but kg \(\[mass\]\)"):
        to_si("7.5 m", "kg")
    with pytest.raises(UndertowError, match=r"'7\.5' has no unit, but kg"):
        to_si("7.5", "kg")


@pytest.mark.parametrize(
    "text",
    [
        *("seven kg", "7.5 kgg", "1 m^9^9^9", "1 9^9^9", "1 m^99", "1 (m", "1 kg m/", "1 m.real", "1 [m]"),
        *("nan m", "1e999 m", "1 dB", "", "7,5 m", "1 m;", "__import__('os')", "1 " + "m" * 200),
        "1 " + " m" * 5000,
    ],
)
def test_unreadable_quantities_are_one_clear_line(text):
    with pytest.raises(UndertowError) as caught:
        to_si(text, "m")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("value", [True, None, [1.0], math.inf, math.nan, 10**400])
def test_values_that_are_no_quantity_are_refused(value):
    with pytest.raises(UndertowError, match="quantity"):
        to_si(value, "m")


def test_scale_and_offset_of_columns():
    assert scale_offset("deg", "rad") == (pytest.approx(math.pi / 180), 0.0)
    assert scale_offset("degC", "K") == (pytest.approx(1.0), 273.15)
    scale, offset = scale_offset("degF", "K")
    assert scale * 212 + offset == pytest.approx(373.15)


def test_angles_count_as_pure_numbers():
    assert dimension("N m s/rad") == dimension("N m s")
    assert dimension("N") != dimension("N m")


@given(st.floats(-1e6, 1e6), st.sampled_from([("deg", "rad"), ("knot", "m/s"), ("mm", "m"), ("degC", "K")]))
def test_there_and_back_again(number, units):
    scale, offset = scale_offset(*units)
    back_scale, back_offset = scale_offset(units[1], units[0])
    assert back_scale * (scale * number + offset) + back_offset == pytest.approx(number, rel=1e-9, abs=1e-9)


def test_pint_is_not_imported_before_it_is_needed():
    code = "import sys, undertow.model.units as units; units.to_si(3, 'm'); sys.exit('pint' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
