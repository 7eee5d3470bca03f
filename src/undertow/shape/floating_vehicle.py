"""A first vehicle file of a hull that floats at the surface, with its memory and a regular wave."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import radians
from typing import Literal

import numpy as np
from scipy.optimize import least_squares, nnls

from undertow.errors import UndertowError
from undertow.model.effects.wave_excitation import ODD, harmonics
from undertow.model.symbols import DOFS, FORCE, VELOCITY
from undertow.typing import Array, Progress

from .floating import Complex, FloatingBody, FloatingHull, RegularWave
from .hull_vehicle import EffectTable, HullSpec, entry_line, hull_tables, text_from_shape
from .mesh import Mesh, bisected


@dataclass(frozen=True)
class FloatingVehicleRules:
    """Uncertainties and limits of numbers that panels have computed."""

    stiffness: float = 0.05  # sigma of what the waterline gives: trim, load, tanks
    radiation: float = 0.10  # sigma of a memory besides the error of its fit
    strips: int = 60  # triangles of the hull under water are no longer than this part of it
    flat: float = 1e-9  # share of the largest triangle below which one has become a line
    small: float = 1e-3  # coefficients of a wave below this share of the largest are left out


_RULES = FloatingVehicleRules()


@dataclass(frozen=True)
class WaveSpec:
    """A regular wave."""

    omega: float  # rad/s
    amplitude: float  # m
    direction: float  # degrees, from north to east: where it travels


@dataclass(frozen=True)
class FloatingVehicle:
    """What was found of a hull that floats."""

    text: str  # of the vehicle file
    hull: FloatingHull
    memory: Memory
    wave: RegularWave | None


def floating_vehicle(
    mesh: Mesh, spec: HullSpec, wave: WaveSpec | None, finest: int, report: Progress
) -> FloatingVehicle:
    """A vehicle file of a hull at the surface; its origin is in the waterline, above the centre of volume.

    `spec.origin` is not looked at; `spec.cg` is from that origin, and has to be straight under or over it.
    """
    _check(spec, wave)
    body = FloatingBody(mesh, spec.mass, spec.cg[2], spec.density, finest)
    whole = mesh.moved(-body.origin)
    found = None if wave is None else body.regular_wave(wave.omega, _inertia(whole, spec))
    hull = body.radiation(report)
    memory = fit_memory(hull, spec.own)
    wet = immersed_part(whole)
    at_surface = replace(spec, origin=np.zeros(3))
    tables = {t.id: t for t in hull_tables(wet, hull.at_infinity, at_surface)}
    own = {t.id: t for t in hull_tables(whole, hull.at_infinity, at_surface)}
    tables["rigid_body"] = own["rigid_body"]
    tables.pop("restoring", None)
    tables.pop("entrained_water", None)
    more = [_waterplane(hull, spec.own), _memory(memory, hull)]
    more += [_excitation(found, wave, spec.own)] if found is not None and wave is not None else []
    extents = " x ".join(f"{e:.4g}" for e in mesh.extents) + " m"
    description = f"First model of {spec.name} at the surface, from its hull ({extents}, {spec.mass:g} kg)"
    shown = [*tables.values(), *(t for t in more if t.entries)]
    text = text_from_shape(spec, list(_about(spec, hull)), description, shown)
    return FloatingVehicle(text, hull, memory, found)


def _check(spec: HullSpec, wave: WaveSpec | None) -> None:
    if not (spec.mass > 0 and np.isfinite(spec.mass)) or not (spec.density > 0 and np.isfinite(spec.density)):
        raise UndertowError(
            f"mass = {spec.mass:g} kg, density = {spec.density:g} kg/m^3: both have to be positive numbers"
        )
    if any(spec.cg[:2]):
        raise UndertowError(
            f"--cg {spec.cg[0]:g},{spec.cg[1]:g},{spec.cg[2]:g}: a hull floats level where its weight is "
            "above its buoyancy: give --cg 0,0,Z"
        )
    if spec.volume is not None:
        raise UndertowError(
            f"--volume {spec.volume:g} is for hulls under water: leave it out with --floating"
        )
    if wave is not None and not (wave.omega > 0 and wave.amplitude >= 0):
        raise UndertowError(
            f"--wave {wave.omega:g},{wave.amplitude:g},{wave.direction:g}: the frequency has to be positive "
            "and the amplitude not negative"
        )


def immersed_part(hull: Mesh) -> Mesh:
    """The closed part of a hull under the plane z = 0, z down; what stands out of the water lies on it."""
    fine = bisected(hull, float(hull.extents.max()) / _RULES.strips)
    laid = Mesh(np.column_stack([fine.vertices[:, :2], np.maximum(fine.vertices[:, 2], 0.0)]), fine.faces)
    return Mesh(laid.vertices, laid.faces[laid.areas > _RULES.flat * laid.areas.max()])


def _inertia(hull: Mesh, spec: HullSpec) -> Array:
    """Mass matrix about the origin, the mass spread evenly but for its centre, shape (6, 6)."""
    m, g = spec.mass, np.array(spec.cg)
    S = np.array([[0.0, -g[2], g[1]], [g[2], 0.0, -g[0]], [-g[1], g[0], 0.0]])
    about = hull.inertia * m / hull.volume - m * S @ S
    return np.block([[m * np.eye(3), -m * S], [m * S, about]])


def _about(spec: HullSpec, hull: FloatingHull) -> Iterator[str]:
    x, y, z = hull.origin
    yield (
        f"It floats with {hull.draught:.4g} m of draught. The origin lies in the waterline, above the centre "
        f"of volume, at ({x:.5g}, {y:.5g}, {z:.5g}) m of the mesh; axes: x forward, y to starboard, z down."
    )
    yield "Small motions without speed ahead: a bow wave, planing and green water are not in it."
    yield from spec.remarks


def _waterplane(hull: FloatingHull, own: Sequence[int]) -> EffectTable:
    source = "waterline, displacement and centre of gravity"
    places = {"Z_z": (2, 2, "N/m"), "K_phi": (3, 3, "N m/rad"), "M_theta": (4, 4, "N m/rad")}
    lines = []
    for name, (i, j, unit) in (places | {"Z_theta": (2, 4, "N/rad")}).items():
        if {i, j} <= set(own):
            value = float(hull.stiffness[i, j])
            scale = float(np.sqrt(hull.stiffness[i, i] * hull.stiffness[j, j]))
            value = value if abs(value) > _RULES.small * scale else 0.0
            sigma = _RULES.stiffness * scale
            lines.append(entry_line(name, -value, unit, sigma=sigma, estimate=i == j, source=source))
    return EffectTable("waterplane", lines)


def _memory(memory: Memory, hull: FloatingHull) -> EffectTable:
    source = (
        f"memory of order {memory.order}, fitted to {len(hull.omega)} frequencies of {hull.panels} panels"
    )
    lines = []
    for name, value in memory.parameters().items():
        i = VELOCITY.index(name[-1]) if name != "T_memory" else None
        unit = "s" if name.startswith("T_") else "rad/s"
        sigma, text = 0.0, source
        if name[0] in FORCE and i is not None:
            unit = "N/m" if i < 3 else "N m/rad"
            sigma = abs(value) * float(np.hypot(_RULES.radiation, memory.error[i]))
            text = f"{source}; {memory.error[i]:.0%} of the kernel is not fitted"
        lines.append(entry_line(name, value, unit, sigma=sigma, source=text))
    return EffectTable(
        memory.effect,
        lines,
        ("Waves that the hull sends out; motions are not coupled by them. The added mass above is that of",
         "infinite frequency and belongs to it."),
    )  # fmt: skip


def _excitation(found: RegularWave, wave: WaveSpec, own: Sequence[int]) -> EffectTable:
    source = f"panels, regular wave of {found.omega:.4g} rad/s"
    going = radians((wave.direction + 180) % 360 - 180)
    lines = [
        entry_line("swell_cos", wave.amplitude, "m", source="as stated"),
        entry_line("swell_frequency", found.omega, "rad/s", source="as stated; forces are of this one alone"),
        entry_line("swell_direction", going, "rad", source="as stated"),
    ]
    drift = np.zeros((len(found.headings), 6))
    drift[:, [0, 1, 5]] = found.drift
    # F = Re((f' + i f'')(p + i q)), with the elevation p and the same a quarter period before, q.
    parts = (("swell", found.excitation.real), ("swellq", -found.excitation.imag), ("drift", drift))
    for mark, values in parts:
        for i in own:
            if values[:, i].any():
                lines += _series_lines(mark, i, found.headings, values[:, i], values, source)
    return EffectTable(
        "wave_excitation",
        lines,
        (f"Harmonics of the heading; they miss {heading_error(found):.1%} of the forces. For "
         "another frequency, make a new file.",),
    )  # fmt: skip


def _series_lines(
    mark: str, i: int, headings: Array, values: Array, alike: Array, source: str
) -> Iterator[str]:
    kind = slice(0, 3) if i < 3 else slice(3, 6)
    floor = _RULES.small * float(np.abs(alike[:, kind]).max())
    unit = ("N" if i < 3 else "N m") + ("/m^2" if mark == "drift" else "/m")
    for n, c in enumerate(_series(i, headings, values)[0], start=int(DOFS[i] in ODD)):
        if abs(c) > floor:
            yield entry_line(f"{FORCE[i]}_{mark}{n}", float(c), unit, source=source)


def _series(i: int, headings: Array, values: Array) -> tuple[Array, Array]:
    """Coefficients of the harmonics nearest to values at headings of one side, and what they miss there."""
    table = np.array([harmonics(DOFS[i], float(h)) for h in headings])
    found = np.asarray(np.linalg.lstsq(table, values, rcond=None)[0])
    return found, values - table @ found


def heading_error(found: RegularWave) -> float:
    """What harmonics of the heading miss of the forces at the headings that were computed, as a share."""
    scale = np.abs(found.excitation).reshape(-1, 2, 3).max(axis=(0, 2))
    rest = []
    for i in range(6):
        values = np.column_stack([found.excitation[:, i].real, found.excitation[:, i].imag])
        missed = _series(i, found.headings, values)[1]
        rest.append(float(np.abs(missed).max() / scale[int(i > 2)]))
    return max(rest)


# --- memory of the water -------------------------------------------------------------------------------
@dataclass(frozen=True)
class MemoryRules:
    """When a fit is good enough."""

    good: float = 0.10  # error at which one state for each motion is enough, of the kernel, root mean square
    none: float = 1e-3  # share of the largest damping (turning: at half the length) that is no memory
    checked: int = 400  # frequencies at which the damping is looked at
    beyond: float = 100.0  # how many times beyond both ends
    # Times in which memories may fade that are tried: how many, and from and to where beyond both ends.
    times: int = 200
    times_beyond: float = 10.0
    starts: tuple[float, ...] = (0.3, 1.0, 3.0)  # times in which memories fade, in periods of the peak


MEMORY = MemoryRules()


@dataclass(frozen=True)
class Memory:
    """A model of the memory: one state for each motion, all of one time constant, or two for each motion.

    The force is minus `stiffness` times the first state; see the effects `radiation_memory` (order 1) and
    `wave_radiation` (order 2) for the states.
    """

    order: Literal[1, 2]
    stiffness: dict[int, float]  # by motion (0 to 5), N/m or N m/rad, positive
    time: dict[int, float]  # s
    frequency: dict[int, float]  # rad/s; none of order 1
    error: dict[int, float]  # root mean square of the residual of the kernel, as a share of it

    @property
    def effect(self) -> str:
        """Id of the effect that has these states."""
        return "radiation_memory" if self.order == 1 else "wave_radiation"

    @property
    def worst(self) -> float:
        """Largest error of all motions."""
        return max(self.error.values(), default=0.0)

    def kernel(self, i: int, omega: Array) -> Complex:
        """Force per velocity of a motion at frequencies (n,), rad/s."""
        return self.stiffness[i] * _shape(omega, self.time[i], self.frequency.get(i, 0.0))

    def parameters(self) -> Mapping[str, float]:
        """Parameters of the effect, SNAME signs."""
        if self.order == 1:
            own = {f"{FORCE[i]}_mem{VELOCITY[i]}": -k for i, k in self.stiffness.items()}
            return own | ({"T_memory": next(iter(self.time.values()))} if own else {})
        rows = [
            (
                (f"{FORCE[i]}_rad{VELOCITY[i]}", -k),
                (f"T_rad_{VELOCITY[i]}", self.time[i]),
                (f"omega_rad_{VELOCITY[i]}", self.frequency[i]),
            )
            for i, k in self.stiffness.items()
        ]
        return dict(pair for row in rows for pair in row)


def fit_memory(hull: FloatingHull, motions: Sequence[int], order: Literal[1, 2] | None = None) -> Memory:
    """The smallest of both models that is good enough, or that of an order; `motions`: 0 to 5.

    Raises `UndertowError` where a model feeds power into the hull at some frequency.
    """
    motions = [i for i in motions if _radiates(hull, i)]
    if order is None:
        first = fit_memory(hull, motions, 1)
        return first if first.worst <= MEMORY.good else fit_memory(hull, motions, 2)
    found = _first_order(hull, motions) if order == 1 else _second_order(hull, motions)
    _check_passive(found, hull.omega)
    return found


def _shape(omega: Array, time: float, frequency: float) -> Complex:
    """Kernel for a stiffness of one: 1/(s + 1/T + w^2/s) at s = i omega."""
    s = 1j * omega
    return np.asarray(1 / (s + 1 / time + frequency**2 / s))


def _radiates(hull: FloatingHull, i: int) -> bool:
    """Whether a motion sends waves out that count: a body of revolution that spins sends none."""
    most = np.array([hull.damping[:, j, j].max() for j in range(3)]).max()
    arm = 1.0 if i < 3 else hull.length / 2
    return float(hull.damping[:, i, i].max()) > MEMORY.none * float(most) * arm**2


def _error(wanted: Complex, found: Complex) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def _first_order(hull: FloatingHull, motions: Sequence[int]) -> Memory:
    """One time constant for all motions, the one that leaves least of all kernels."""
    kernels = {i: hull.kernel(i) for i in motions}

    def stiffness(time: float) -> dict[int, float]:
        shape = _shape(hull.omega, time, 0.0)
        table = np.concatenate([shape.real, shape.imag])[:, None]
        return {i: float(nnls(table, np.concatenate([k.real, k.imag]))[0][0]) for i, k in kernels.items()}

    def left(time: float) -> float:
        shape = _shape(hull.omega, time, 0.0)
        return sum(_error(kernels[i], k * shape) ** 2 for i, k in stiffness(time).items())

    far = MEMORY.times_beyond
    times = np.geomspace(1 / far / hull.omega[-1], far / hull.omega[0], MEMORY.times)
    best = float(min(times, key=left))
    shape, own = _shape(hull.omega, best, 0.0), stiffness(best)
    errors = {i: _error(kernels[i], k * shape) for i, k in own.items()}
    return Memory(1, own, dict.fromkeys(own, best), {}, errors)


def _second_order(hull: FloatingHull, motions: Sequence[int]) -> Memory:
    found = {i: _resonance(hull.omega, hull.kernel(i)) for i in motions}
    errors = {i: _error(hull.kernel(i), k * _shape(hull.omega, T, w)) for i, (k, T, w) in found.items()}
    k, T, w = ({i: row[j] for i, row in found.items()} for j in range(3))
    return Memory(2, k, T, w, errors)


def _resonance(omega: Array, kernel: Complex) -> tuple[float, float, float]:
    """Stiffness, time and frequency of the resonance nearest to a kernel; all positive, hence passive."""
    peak = float(omega[np.argmax(kernel.real)])
    height = float(kernel.real.max())

    def off(x: Array) -> Array:
        k, T, w = np.exp(x)
        rest = (k * _shape(omega, T, w) - kernel) / height
        return np.concatenate([rest.real, rest.imag])

    starts = [np.log([height / T, T, peak]) for T in np.array(MEMORY.starts) * 2 * np.pi / peak]
    best = min((least_squares(off, x) for x in starts), key=lambda r: r.cost)
    k, T, w = np.exp(best.x)
    return float(k), float(T), float(w)


def _check_passive(memory: Memory, omega: Array) -> None:
    far = np.geomspace(omega[0] / MEMORY.beyond, omega[-1] * MEMORY.beyond, MEMORY.checked)
    for i in memory.stiffness:
        least = float(memory.kernel(i, far).real.min())
        if not least >= 0:
            raise UndertowError(
                f"memory of {VELOCITY[i]}: damping {least:.3g} below 0 at some frequency: fit other motions"
            )
