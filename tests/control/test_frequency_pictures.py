"""Frequency responses as they are drawn: singular values, Nyquist and Nichols."""

from __future__ import annotations

from pathlib import Path

import control as ct
import numpy as np
import pytest

from undertow.control.gains import load_gains
from undertow.control.linear.analysis import margins, singular_values
from undertow.control.linear.pictures import picture
from undertow.control.linear.report import Analysis
from undertow.control.linear.trim import find_trim
from undertow.model.loading import load_vehicle


def test_singular_values_are_those_of_the_resolvent() -> None:
    rng = np.random.default_rng(6)
    a = rng.normal(size=(4, 4)) - 3 * np.eye(4)
    b, c = rng.normal(size=(4, 3)), rng.normal(size=(2, 4))
    omega = np.geomspace(0.1, 10, 7)
    found = singular_values(ct.ss(a, b, c, np.zeros((2, 3))), omega)
    assert found.shape == (2, 7)
    for w, column in zip(omega, found.T, strict=True):
        matrix = c @ np.linalg.solve(1j * w * np.eye(4) - a, b)
        # The largest is the norm, and the product of the squares the determinant of G G*.
        assert column[0] == pytest.approx(np.linalg.norm(matrix, 2))
        assert np.prod(column) ** 2 == pytest.approx(np.linalg.det(matrix @ matrix.conj().T).real)


def test_disk_margins_are_the_closed_forms() -> None:
    # L = k/s: |1 + L| = |1 - L| on the axis, so the disk is the largest there is.
    assert margins(ct.ss([[0.0]], [[1.0]], [[3.0]], 0.0)).disk == pytest.approx(2.0)
    loop = ct.ss(ct.tf([4.0], [1.0, 2.0, 1.0, 0.0]) * 0.25)
    omega = np.geomspace(1e-3, 1e3, 200_001)
    gain = 1.0 / np.polyval([1.0, 2.0, 1.0, 0.0], 1j * omega)
    found = margins(loop)
    assert found.disk == pytest.approx((2 * np.abs(1 + gain) / np.abs(1 - gain)).min(), rel=1e-6)
    # What the disk allows is no more than the margins of gain and phase by themselves.
    assert (2 + found.disk) / (2 - found.disk) <= found.gain
    assert np.degrees(2 * np.arctan(found.disk / 2)) <= found.phase
    assert margins(ct.ss(ct.tf([9.0], [1.0, 2.0, 1.0, 0.0]))).disk == 0.0


def test_nyquist_and_nichols_draw_the_loop_that_the_margins_are_of() -> None:
    vehicle = load_vehicle("mini-auv")
    found = Analysis(vehicle, find_trim(vehicle), load_gains("paper-pd", vehicle))
    margin = found.margins(found.main_channels)["force_surge"]
    nyquist = picture("nyquist", found, found.main_channels).axes[0]
    line = next(x for x in nyquist.lines if x.get_label() == "force_surge")
    x, y = line.get_data()
    distances = np.hypot(np.array(x) + 1, y)
    assert distances.min() == pytest.approx(margin.distance, rel=1e-2)
    disks = picture("disk-margins", found, found.main_channels).axes[0].lines[0].get_ydata()
    assert np.min(disks) == pytest.approx(margin.disk, rel=1e-3)
    nichols = picture("nichols", found, found.main_channels).axes[0]
    line = next(x for x in nichols.lines if x.get_label() == "force_surge")
    phase, size = line.get_data()
    at_one = np.interp(0.0, np.array(size)[::-1], np.array(phase)[::-1])
    assert 180 + at_one == pytest.approx(margin.phase, abs=0.5)


@pytest.mark.parametrize("kind", ["nyquist", "nichols", "singular-values", "disk-margins"])
def test_axes_have_units_and_curves_that_coincide_are_both_seen(kind: str, tmp_path: Path) -> None:
    """Roll and pitch of bluerov2 have the same damping and inertia."""
    path = tmp_path / "gains.toml"
    gains = ", ".join(f"{c} = 25" for c in ("x", "y", "z", "phi", "theta", "psi"))
    path.write_text(
        'schema = "undertow/gains/1"\nname = "rov"\nlaw = "pd"\n[gains]\n'
        f"K_P = {{ {gains} }}\nK_V = {{ {gains} }}\n"
    )
    vehicle = load_vehicle("bluerov2")
    found = Analysis(vehicle, find_trim(vehicle), load_gains(path, vehicle))
    (axis,) = picture(kind, found, found.main_channels).axes
    for label in (axis.get_xlabel(), axis.get_ylabel()):
        assert label.endswith("]")
    lines = [x for x in axis.lines if x.get_label().startswith(("force_", "singular"))]
    assert len(lines) == 6
    assert any(x.get_linestyle() == "--" for x in lines)
    assert any(x.get_linestyle() == "-" for x in lines)
    assert axis.get_legend().get_frame().get_alpha() > 0.5  # no line runs through its words
