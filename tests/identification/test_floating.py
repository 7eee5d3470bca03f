"""A hull at the surface: its memory as a state-space model, and panels against what is known."""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest
import tomlkit

import undertow as ut
from benchmarks.shape.hulls import ball, box_mesh
from benchmarks.shape.hulme import ADDED, DAMPING
from benchmarks.shape.usv import CG, MASS, usv_hull
from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.symbols import VELOCITY, signals, symbol
from undertow.shape.bodies import AddedMass
from undertow.shape.floating import FloatingBody, FloatingHull
from undertow.shape.floating_vehicle import (
    FloatingVehicle,
    Memory,
    WaveSpec,
    fit_memory,
    floating_vehicle,
    immersed_part,
)
from undertow.shape.hull_vehicle import HullSpec
from undertow.shape.mesh import has_capytaine

panels = pytest.mark.skipif(not has_capytaine(), reason="needs capytaine")
OMEGA = np.geomspace(0.3, 9.0, 24)
G, RHO = 9.81, 1000.0


def hull_with(memory: Memory) -> FloatingHull:
    """A hull whose frequency-dependent part is exactly that of a state-space model."""
    added, damping = np.zeros((2, len(OMEGA), 6, 6))
    for i in memory.stiffness:
        kernel = memory.kernel(i, OMEGA)
        damping[:, i, i], added[:, i, i] = kernel.real, kernel.imag / OMEGA + 5.0
    still = AddedMass(5.0 * np.eye(6), "stated", "none", np.zeros((6, 6)))
    return FloatingHull(np.zeros(3), 1.0, 2.0, np.eye(6), still, OMEGA, added, damping, 100)


SWINGING = Memory(2, {0: 40.0, 2: 300.0, 4: 70.0}, {0: 0.5, 2: 0.3, 4: 0.4}, {0: 3.0, 2: 2.0, 4: 2.5}, {})


def test_memory_of_two_states_is_found_again() -> None:
    found = fit_memory(hull_with(SWINGING), range(6))
    assert found.order == 2
    assert found.worst < 1e-6
    for i in (0, 2, 4):
        expected = (SWINGING.stiffness[i], SWINGING.time[i], SWINGING.frequency[i])
        assert (found.stiffness[i], found.time[i], found.frequency[i]) == pytest.approx(expected, rel=1e-5)
    assert set(found.stiffness) == {0, 2, 4}, "motions that make no waves have no memory"


def test_one_state_is_chosen_where_it_is_enough() -> None:
    fading = Memory(1, {0: 40.0, 2: 300.0}, {0: 0.8, 2: 0.8}, {}, {})
    found = fit_memory(hull_with(fading), (0, 2))
    assert (found.order, found.effect) == (1, "radiation_memory")
    assert found.parameters()["T_memory"] == pytest.approx(0.8, rel=0.03)
    assert found.parameters()["Z_memw"] == pytest.approx(-300.0, rel=0.05)


@pytest.mark.parametrize("order", [1, 2])
def test_effects_have_the_kernel_that_was_fitted(order: int) -> None:
    fading = Memory(1, {0: 40.0, 2: 300.0}, {0: 0.8, 2: 0.8}, {}, {})
    memory = fading if order == 1 else SWINGING
    effect = catalogue()[memory.effect]()
    s, states = signals(), effect.state_symbols
    values = {symbol(n): v for n, v in memory.parameters().items()}
    silent = {symbol(p.name): p.default or 0.0 for p in effect.parameters if symbol(p.name) not in values}
    water = dict(zip([*s.nu_r], [*s.nu], strict=True))
    rates, force = (m.subs(water).subs(values | silent) for m in (effect.rates(s), effect.wrench(s)))
    A, B, C = (
        np.array(m.tolist(), dtype=float)
        for m in (rates.jacobian(states), rates.jacobian(s.nu), force.jacobian(states))
    )
    for omega in (0.2, 2.0, 7.0):
        response = -C @ np.linalg.solve(1j * omega * np.eye(len(A)) - A, B)
        for i in memory.stiffness:
            assert response[i, i] == pytest.approx(complex(memory.kernel(i, np.array([omega]))[0]), rel=1e-9)
    assert np.linalg.eigvals(A).real.max() < 0


def test_slow_motion_makes_no_waves_and_no_motion_gains_power() -> None:
    slow = SWINGING.kernel(2, np.array([1e-6]))[0].real
    fast = SWINGING.kernel(2, np.geomspace(1e-3, 1e3, 200)).real
    assert slow < 1e-9 * fast.max()
    assert fast.min() >= 0


def test_what_is_computed_from_a_shape_is_never_searched_for_in_a_log() -> None:
    from undertow.identification.diagnosis.candidates import possible

    vehicle = ut.load_vehicle("bluerov2")
    assert not {"waterplane", "wave_radiation", "wave_excitation"} & {
        c.id for c in possible(vehicle, catalogue())
    }


def test_hull_under_water_is_what_the_plane_leaves_of_it() -> None:
    box = box_mesh((0.6, 0.4, 0.2))
    wet = immersed_part(box.moved(np.array([0.0, 0.0, 0.04])))
    assert wet.volume == pytest.approx(0.6 * 0.4 * 0.14, rel=1e-3)
    assert wet.projected_area(2) == pytest.approx(0.24, rel=0.02)


# --- with panels ----------------------------------------------------------------------------------
@panels
def test_box_floats_as_archimedes_says() -> None:
    length, beam, draught, cg = 2.0, 1.0, 0.3, 0.05
    mass = RHO * length * beam * draught
    body = FloatingBody(box_mesh((length, beam, 0.5)), mass, cg, RHO, 800)
    assert body.draught == pytest.approx(draught, rel=1e-4)
    assert body.origin == pytest.approx([0, 0, 0.25 - draught], abs=1e-4)
    gm = [beam**2 / 12 / draught - draught / 2 + cg, length**2 / 12 / draught - draught / 2 + cg]
    expected = [RHO * G * length * beam, mass * G * gm[0], mass * G * gm[1]]
    assert np.diag(body.stiffness)[2:5] == pytest.approx(expected, rel=0.01)


@panels
@pytest.mark.parametrize(
    ("mass", "cg", "words"),
    [(1100.0, 0.0, "it sinks"), (990.0, 0.0, "of the height"), (600.0, -0.5, "does not float upright")],
)
def test_hulls_that_do_not_float_are_refused(mass: float, cg: float, words: str) -> None:
    with pytest.raises(UndertowError, match=words):
        FloatingBody(box_mesh((2.0, 1.0, 0.5)), mass, cg, RHO, 400)


HALF = 2 / 3 * pi * RHO  # kg, displaced by a half-sphere of radius 1 m


@pytest.fixture(scope="module")
def half_sphere() -> FloatingBody:
    return FloatingBody(ball(4), HALF, 0.3, RHO, 1600)


@panels
@pytest.mark.slow
@pytest.mark.parametrize("ka", [0.4, 1.0, 2.0, 5.0])
def test_half_sphere_against_hulme(half_sphere: FloatingBody, ka: float) -> None:
    omega = np.sqrt(G * ka)
    found = half_sphere.at(omega) / HALF
    for i, motion in ((0, "surge"), (2, "heave")):
        # Flat panels enclose 0.7% too little, and damping is small where hardly any waves are made.
        assert found[i, i].real == pytest.approx(ADDED[motion][ka], rel=0.02)
        if (damping := DAMPING[motion].get(ka)) is not None:
            assert found[i, i].imag / omega == pytest.approx(damping, rel=0.03, abs=0.002)


@panels
@pytest.mark.slow
def test_half_sphere_has_no_irregular_frequency(half_sphere: FloatingBody) -> None:
    """Without a lid the damping in heave falls by a third at the first frequency of the water inside."""
    inside = 2.56
    omega = np.sqrt(G * inside)
    table = sorted(DAMPING["heave"].items())
    expected = np.interp(inside, [k for k, _ in table], [b for _, b in table])
    assert half_sphere.at(omega)[2, 2].imag / HALF / omega == pytest.approx(expected, rel=0.06)


@panels
@pytest.mark.slow
def test_damping_is_what_excitation_says_and_short_waves_are_thrown_back(half_sphere: FloatingBody) -> None:
    """Haskind's relation in heave, and the drift of waves that a round wall throws back (Havelock 1940)."""
    inertia = np.diag([HALF] * 3 + [0.4 * HALF] * 3)
    omega = float(np.sqrt(G * 1.0))
    wave = half_sphere.regular_wave(omega, inertia)
    heave = wave.excitation[:, 2]
    assert np.abs(heave) == pytest.approx(np.abs(heave[0]), rel=0.01), "the same from all sides"
    haskind = omega**3 * np.abs(heave[0]) ** 2 / (2 * RHO * G**3)
    assert half_sphere.at(omega)[2, 2].imag == pytest.approx(haskind, rel=0.03)
    short = half_sphere.regular_wave(float(np.sqrt(G * 5.0)), inertia).drift
    assert np.hypot(*short[:, :2].T) == pytest.approx(2 / 3 * RHO * G, rel=0.1)
    assert short[4, 1] > 0, "a wave that travels to starboard pushes to starboard"
    long = half_sphere.regular_wave(0.8, inertia)
    assert long.excitation[0, 2].real == pytest.approx(-RHO * G * pi, rel=0.1), "a crest lifts"
    assert np.abs(long.drift[:, :2]).max() < 0.02 * RHO * G


@pytest.fixture(scope="module")
def usv() -> FloatingVehicle:
    spec = HullSpec("usv", "usv.stl", "0" * 64, MASS, RHO, (0.0, 0.0, CG), ("heave", "pitch"), np.zeros(3))
    return floating_vehicle(usv_hull(), spec, WaveSpec(4.0, 0.02, 180.0), 1600, lambda done, words: None)


@panels
@pytest.mark.slow
def test_vehicle_file_swings_in_a_head_sea_as_the_panels_say(usv: FloatingVehicle, tmp_path: Path) -> None:
    """The simulated vehicle, memory and all, against the linear equations at the frequency of the wave."""
    document = tomlkit.parse(usv.text)
    for drag in ("linear_damping", "quadratic_damping"):
        del document["effects"][drag]  # type: ignore[union-attr]
    file = tmp_path / "usv.toml"
    file.write_text(tomlkit.dumps(document), encoding="utf-8")
    model = ut.compile(ut.load_vehicle(file))
    dt, omega = 0.02, 4.0
    x = model.simulate(np.zeros(len(model.states)), np.zeros((3000, 2)), dt)[2000:]
    t = dt * np.arange(2000, 3000)
    table = np.column_stack([np.cos(omega * t), np.sin(omega * t), np.ones(len(t))])
    wave, hull = usv.wave, usv.hull
    assert wave is not None
    k = int(np.argmin(np.abs(hull.omega - omega)))
    own = np.ix_([2, 4], [2, 4])
    values = ut.load_vehicle(file)
    body = np.diag([MASS, values.value_of("I_y").value])
    added = np.array([np.interp(omega, hull.omega, hull.added[:, i, j]) for i in (2, 4) for j in (2, 4)])
    damped = np.array([np.interp(omega, hull.omega, hull.damping[:, i, j]) for i in (2, 4) for j in (2, 4)])
    system = -(omega**2) * (body + added.reshape(2, 2)) - 1j * omega * damped.reshape(2, 2)
    expected = 0.02 * np.linalg.solve(system + hull.stiffness[own], wave.excitation[-1][[2, 4]])
    for name, wanted in zip(("z", "theta"), expected, strict=True):
        c, s, _ = np.linalg.lstsq(table, x[:, model.states.index(name)], rcond=None)[0]
        assert c + 1j * s == pytest.approx(complex(wanted), abs=0.15 * abs(wanted)), (name, k)


@panels
@pytest.mark.slow
def test_memory_of_a_usv_is_small_and_passive(usv: FloatingVehicle) -> None:
    assert usv.memory.order == 2
    assert set(usv.memory.stiffness) == {2, 4}
    assert usv.memory.worst < 0.25
    assert all(p in VELOCITY for p in ("w", "q"))
