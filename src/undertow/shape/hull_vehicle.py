"""A first vehicle file from the shape of a hull: each value with where it is from and how far to trust it."""

from __future__ import annotations

import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import tomlkit
from pydantic import ValidationError

from undertow.errors import UndertowError
from undertow.files import templates
from undertow.model.catalogue import catalogue
from undertow.model.effects.added_mass import AddedMass as AddedMassEffect
from undertow.model.effects.added_mass_coupling import AddedMassCoupling
from undertow.model.effects.linear_damping import LinearDamping
from undertow.model.loading import vehicle_from_table
from undertow.model.symbols import DOFS, ENVIRONMENT, FORCE, VELOCITY
from undertow.model.tables import VehicleTable
from undertow.model.vehicle import Value, Vehicle
from undertow.typing import Array

from .bodies import AddedMass
from .mesh import Mesh, bisected
from .panels import Radiation


@dataclass(frozen=True)
class HullRules:
    """How drag and priors follow from a shape; a share is a standard deviation over its value."""

    # friction coefficient of a turbulent boundary layer, for turning hulls: drag coefficients contain it
    friction: float = 0.005
    # triangles are no longer than this part of the hull: integrals over them are good to 1%
    strips: int = 30
    blunt: float = 0.8  # bluntness from which the drag coefficient is that of a blunt form
    rounded: float = 0.4  # the same of a rounded form; below it the form is streamlined
    stated_drag: float = 0.3  # share by which a drag coefficient that is stated may be wrong
    hollow: float = 1e-3  # share by which a stated volume may exceed that of the hull: rounding
    added_mass: float = 0.10  # share that potential flow and an ideal shape leave open of added mass
    radiation: float = 0.5  # share: waves at one frequency say little of linear damping at all others
    coupling: float = 0.01  # couplings below this share of the two motions they couple are left out
    least: float = 0.02  # what moves no ideal fluid moves some real water: share of the largest of its kind
    buoyancy: float = 0.02  # share that a drawing misses: hollows, cables, foam that is compressed
    inertia: float = 0.3  # share by which evenly spread mass may miss the moments of inertia
    even_speed: float = 0.1  # m/s, at which linear drag is assumed to equal quadratic drag
    rounding: float = 1e-6  # products of inertia and arms below this share of the size are rounding


_RULES = HullRules()

_ROUNDING = 1e-12  # of the added masses, or moments, of the other axes
_HOERNER = "Hoerner (1965), Fluid-Dynamic Drag, chapter 3"
_CLASSES = {
    "blunt": (1.05, 0.4, f"between a cube face on (1.05) and a long plate; {_HOERNER}"),
    "rounded": (0.8, 0.5, f"between a sphere (0.47) and a long circular cylinder (1.1 to 1.2); {_HOERNER}"),
    "streamlined": (
        0.2,
        0.75,
        "a slender body with the appendages that vehicles have; bare hulls are below 0.1",
    ),
}


@dataclass(frozen=True)
class Drag:
    """Quadratic drag of a hull about an origin."""

    coefficients: Array  # (6,): force per speed squared, kg/m, and moment per rate squared, kg m^2; positive
    sigma: Array  # (6,): how far to trust them
    sources: tuple[str, ...]  # where each is from


def drag_of_hull(mesh: Mesh, density: float = 1000.0, cd: Sequence[float] | None = None) -> Drag:
    """Drag by silhouettes in translation, and by the speeds of all strips of the surface in rotation.

    `density`: of the water, kg/m^3; `cd` (3,): drag coefficients on the silhouettes seen along x, y and z; by
    the form of the hull if None.

    Force: density/2 C_d times silhouette. Moment: every strip of surface gives half of that for its own
    normal velocity, so that a box gets what strip theory gives its sides, and a hull that turns about its
    axis of revolution gets friction only.
    """
    for value in cd or ():
        if not (value >= 0 and np.isfinite(value)):
            raise UndertowError(f"drag coefficient {value:g} is impossible: give 0 or more, such as 1.0")
    areas = np.array([mesh.projected_area(i) for i in range(3)])
    mesh = bisected(mesh, float(mesh.extents.max()) / _RULES.strips)
    facing = np.abs(mesh.vector_areas) / mesh.areas[:, None]
    blunt = (mesh.areas @ facing**3) / 2 / areas
    chosen = [_coefficient(float(b), None if cd is None else float(cd[i])) for i, b in enumerate(blunt)]
    values, shares, sources = zip(*chosen, strict=True)
    forces = density / 2 * np.array(values) * areas
    moments = density / 2 * _moments(mesh, np.array(values) / blunt, facing)
    turning = float(np.hypot(0.5, max(shares)))
    text = [f"C_d {v:g} on {a:.4g} m^2: {s}" for v, a, s in zip(values, areas, sources, strict=True)]
    about = "strips of the surface with the drag coefficients of x, y and z, and friction"
    return Drag(
        np.concatenate([forces, moments]),
        np.concatenate([forces * np.array(shares), moments * turning]),
        (*text, *[about] * 3),
    )


def _coefficient(bluntness: float, stated: float | None) -> tuple[float, float, str]:
    """Drag coefficient, its standard deviation as a share, and where it is from."""
    if stated is not None:
        return stated, _RULES.stated_drag, "coefficient as stated"
    form = (
        "blunt" if bluntness >= _RULES.blunt else "rounded" if bluntness >= _RULES.rounded else "streamlined"
    )
    value, share, source = _CLASSES[form]
    return value, share, f"{form} this way (bluntness {bluntness:.2f}), {source}"


def _moments(mesh: Mesh, weights: Array, facing: Array) -> Array:
    """Integrals of the speeds cubed over the surface for a unit rate about x, y and z, m^5."""
    found = []
    places, areas = _points(mesh)
    normals = np.repeat(mesh.vector_areas / mesh.areas[:, None], 3, axis=0)
    pressure = np.repeat(facing**2 @ weights, 3)
    for axis in np.eye(3):
        speed = np.cross(axis, places)
        normal = np.sum(speed * normals, axis=1)
        along = np.linalg.norm(speed - normal[:, None] * normals, axis=1)
        found.append(areas @ (pressure * np.abs(normal) ** 3 / 2 + _RULES.friction * along**3))
    return np.array(found)


def _points(mesh: Mesh) -> tuple[Array, Array]:
    """Three points of each triangle, with a third of its area: exact for squares."""
    corners = mesh.corners
    places = corners / 2 + corners.sum(axis=1, keepdims=True) / 6
    return places.reshape(-1, 3), np.repeat(mesh.areas / 3, 3)


def sigma_of(added: AddedMass, floor: float = _RULES.added_mass) -> Array:
    """Standard deviations of a prior, shape (6, 6): its error, and a share of the two motions it couples."""
    return np.hypot(added.error, floor * _scales(added.matrix))


def _scales(matrix: Array) -> Array:
    own = np.maximum(np.diag(matrix), 0.0)
    least = _RULES.least * np.repeat(own.reshape(2, 3).max(axis=1), 3)
    root = np.sqrt(np.maximum(own, np.maximum(least, 1e-12)))
    return np.asarray(np.outer(root, root))


def coupled(matrix: Array) -> list[tuple[int, int]]:
    """Places above the diagonal of couplings that matter."""
    scales = _scales(matrix)
    return [
        (i, j)
        for i in range(6)
        for j in range(i + 1, 6)
        if abs(matrix[i, j]) > _RULES.coupling * scales[i, j]
    ]


def entry(added: AddedMass, i: int, j: int) -> float:
    """An entry of the matrix; what rounding has left on the diagonal is zero."""
    value, alike = float(added.matrix[i, j]), np.diag(added.matrix)[3 * (i // 3) :][:3]
    return 0.0 if i == j and value < _ROUNDING * alike.max() else value


def derivative(i: int, j: int) -> str:
    """SNAME name of an entry of the added mass: `derivative(0, 0)` is X_udot."""
    return f"{FORCE[i]}_{VELOCITY[j]}dot"


def with_added_mass(vehicle: Vehicle, added: AddedMass, *, floor: float = _RULES.added_mass) -> Vehicle:
    """The vehicle with this added mass as prior: `X_udot` and so on to be estimated, with their sigma."""
    sigma, own = sigma_of(added, floor), vehicle.dof_indices
    diagonal = {derivative(i, i): (i, i) for i in own}
    pairs = {(i, j) for i, j in coupled(added.matrix) if i in own and j in own}
    stated = {(i, j) for i in own for j in own if i < j and derivative(i, j) in vehicle.values}
    off = {derivative(i, j): (i, j) for i, j in sorted(pairs | stated)}
    for cls, names, estimate in ((AddedMassEffect, diagonal, True), (AddedMassCoupling, off, False)):
        values = {
            key: _prior(entry(added, *at), estimate, float(sigma[at]), added.source)
            for name, at in names.items()
            for key in _keys(vehicle, name)
        }
        vehicle = vehicle.with_effect(cls, values) if values else vehicle
    return vehicle


def _prior(added: float, estimate: bool, sigma: float, source: str) -> Value:
    """A sphere that spins moves nothing, and there is nothing to be estimated."""
    return Value(0.0 - added, estimate, sigma, source) if added or sigma > 1e-9 else Value(0.0, source=source)


def with_radiation(vehicle: Vehicle, radiation: Radiation, source: str) -> Vehicle:
    """The vehicle with radiation damping at one frequency as prior of its linear damping."""
    damping = np.diag(radiation.damping)
    names = {f"{FORCE[i]}_{VELOCITY[i]}": i for i in vehicle.dof_indices if damping[i] > 0}
    text = f"radiation damping at {radiation.omega:g} rad/s; {source}"
    values = {
        key: Value(
            -float(damping[i]),
            True,
            float(np.hypot(radiation.error[i, i], _RULES.radiation * damping[i])),
            text,
        )
        for name, i in names.items()
        for key in _keys(vehicle, name)
    }
    return vehicle.with_effect(LinearDamping, values)


def _keys(vehicle: Vehicle, name: str) -> list[str]:
    ways = [f"{name}_{way}" for way in ("forward", "backward")]
    return ways if ways[0] in vehicle.values else [name]


_WIDTH = 110
_UNITS = {"m": ("kg", "kg m^2"), "d": ("kg/s", "kg m^2/s"), "q": ("kg/m", "kg m^2")}


@dataclass(frozen=True)
class HullSpec:
    """What a first vehicle file states besides the shape."""

    name: str
    mesh: str  # file of the hull, for the record
    sha256: str  # of that file
    mass: float  # kg
    density: float  # of the water, kg/m^3
    cg: tuple[float, float, float]  # (3,): centre of gravity from the origin, m, body axes
    degrees_of_freedom: tuple[str, ...]  # motions that the model has
    origin: Array  # (3,): origin of the vehicle in the coordinates of the mesh, m
    # (3,): drag coefficients along x, y and z; by the form of the hull if None
    cd: tuple[float, float, float] | None = None
    # what the hull displaces if water gets into it, m^3; what it encloses if None
    volume: float | None = None
    remarks: tuple[str, ...] = ()  # what else a reader of the file should know
    cg_source: str = "as stated"  # where the centre of gravity is from

    @property
    def own(self) -> list[int]:
        """Places of the motions among the six."""
        return [DOFS.index(d) for d in self.degrees_of_freedom]


@dataclass(frozen=True)
class EffectTable:
    """One effect of the file."""

    id: str
    entries: list[str]
    comments: tuple[str, ...] = ()

    def is_of(self, hardware: Hardware) -> bool:
        """Whether it has a value of a thruster, rudder or fin."""
        return any(entry.split(" ")[0].endswith(f"_{hardware.name}") for entry in self.entries)


@dataclass(frozen=True)
class Hardware:
    """A thruster, rudder or fin of the file."""

    name: str
    position: tuple[float, float, float]  # m
    direction: tuple[float, float, float]  # of its force for a positive command
    source: str
    at_rest: bool = True  # whether it pushes at rest, a unit per unit of its command
    limit: str = ""  # of its command, with what it is assumed from

    def acts_in(self, degrees_of_freedom: Iterable[str]) -> bool:
        """Whether its force, or the moment of that about the origin, drives one of some motions."""
        wrench = (*self.direction, *np.cross(self.position, self.direction))
        return any(wrench[DOFS.index(motion)] for motion in degrees_of_freedom)


def hull_vehicle(hull: Mesh, added: AddedMass, spec: HullSpec, tested: Sequence[EffectTable] = ()) -> str:
    """The text of a vehicle file for a hull; `tested` has values that are better than those of its shape."""
    _check(hull, spec)
    mesh, added = hull.moved(-spec.origin), added.placed(np.eye(3), -spec.origin)
    description = f"First model of {spec.name} from its hull ({_size(mesh)}, {spec.mass:g} kg)"
    tables = [_with_tests(t, tested) for t in hull_tables(mesh, added, spec)]
    return text_from_shape(spec, list(_about(mesh, spec)), description, tables)


def text_from_shape(spec: HullSpec, about: list[str], description: str, tables: list[EffectTable]) -> str:
    """The text of a vehicle file whose values are those of the shape of a hull."""
    return vehicle_text(
        made_from=f"{spec.mesh} (sha256 {spec.sha256})",
        about=about,
        name=spec.name,
        description=description,
        source=f"shape of {spec.mesh}, mass as stated; no test yet",
        degrees_of_freedom=spec.degrees_of_freedom,
        density=spec.density,
        tables=tables,
    )


def _with_tests(table: EffectTable, tested: Sequence[EffectTable]) -> EffectTable:
    """A table with the values of tests in place of its own."""
    better = {line.split(" = ")[0]: line for t in tested if t.id == table.id for line in t.entries}
    return replace(table, entries=[better.get(line.split(" = ")[0], line) for line in table.entries])


def vehicle_text(
    *,
    made_from: str,
    about: list[str],
    name: str,
    description: str,
    source: str,
    degrees_of_freedom: tuple[str, ...],
    density: float,
    tables: list[EffectTable],
    hardware: Sequence[Hardware] = (),
) -> str:
    """The text of a vehicle file, which is known to be a valid one."""
    render = partial(
        templates("undertow.shape").get_template("vehicle.txt").render,
        made_from=_plain(made_from),
        about=[part for line in about for part in textwrap.wrap(_plain(line), _WIDTH)],
        name=_quoted(name),
        description=_quoted(description),
        source=_quoted(source),
        degrees_of_freedom=[_quoted(d) for d in degrees_of_freedom],
        water_density=_quoted(f"{density:g} kg/m^3"),
        forces=[] if hardware else [_quoted(f"tau_{FORCE[DOFS.index(d)]}") for d in degrees_of_freedom],
    )
    left = _of_its_motions(tables, render(effects=tables, hardware=hardware))
    acting = [h for h in hardware if h.acts_in(degrees_of_freedom) or any(t.is_of(h) for t in left)]
    return str(render(effects=left, hardware=acting)).rstrip() + "\n"


def _of_its_motions(tables: Sequence[EffectTable], text: str) -> list[EffectTable]:
    """Tables of a vehicle file without what is to be estimated of motions that the vehicle does not have."""
    try:
        vehicle = vehicle_from_table(VehicleTable.model_validate(tomllib.loads(text)), catalogue())
    except ValidationError as error:
        raise UndertowError(f"no vehicle file can be made from it: {error.errors()[0]['msg']}") from error
    used = {*vehicle.parameter_names}
    foreign = {n for n, v in vehicle.values.items() if v.estimate} - used
    # Of roll and pitch alone, the righting moment remains, which has to be given with the buoyancy.
    acting = [e for e in vehicle.effects if used & {p.name for p in e.parameters}]
    needed = foreign & {p.name for e in acting for p in e.parameters if p.must_be_given}

    def kept(entry: str) -> Iterator[str]:
        name = entry.split(" ")[0]
        if name in needed:
            yield entry.replace("estimate = true, ", "")
        elif name not in foreign:
            yield entry

    left = [replace(t, entries=[e for entry in t.entries for e in kept(entry)]) for t in tables]
    return [new for new, old in zip(left, tables, strict=True) if new.entries or not old.entries]


def _check(hull: Mesh, spec: HullSpec) -> None:
    for what, value, unit in (("mass", spec.mass, "kg"), ("density", spec.density, "kg/m^3")):
        if not (value > 0 and np.isfinite(value)):
            raise UndertowError(f"{what} = {value:g} {unit} is impossible: give a positive number")
    if spec.volume is not None and not 0 < spec.volume <= hull.volume * (1 + _RULES.hollow):
        raise UndertowError(
            f"volume = {spec.volume:g} m^3 is impossible: the hull encloses {hull.volume:.4g} m^3, and water "
            "that gets in leaves less"
        )


def _about(mesh: Mesh, spec: HullSpec) -> Iterator[str]:
    surface = float(mesh.areas.sum())
    yield f"The hull is {_size(mesh)}, encloses {mesh.volume:.6g} m^3 and has {surface:.4g} m^2 of surface."
    x, y, z = spec.origin
    yield (
        f"The origin is at ({x:.5g}, {y:.5g}, {z:.5g}) m of the mesh; axes: x forward, y to starboard, "
        "z down."
    )
    yield from spec.remarks


def _size(mesh: Mesh) -> str:
    return " x ".join(f"{e:.4g}" for e in mesh.extents) + " m"


# --- effects --------------------------------------------------------------------------------------
def hull_tables(mesh: Mesh, added: AddedMass, spec: HullSpec) -> Iterator[EffectTable]:
    """Tables of the effects that a shape gives, about its origin; those without entries are left out."""
    drag = drag_of_hull(mesh, spec.density, cd=spec.cd)
    found = _tables(mesh, added, drag, spec)
    yield from (t for t in found if t.entries or t.id.endswith("_coriolis"))


def _tables(mesh: Mesh, added: AddedMass, drag: Drag, spec: HullSpec) -> Iterator[EffectTable]:
    turns = len(spec.own) > 1
    yield EffectTable("rigid_body", list(_rigid_body(mesh, spec)))
    if turns:
        yield EffectTable("rigid_body_coriolis", [])
    if spec.volume is not None:
        yield EffectTable("entrained_water", list(_water(mesh, spec, spec.volume)))
    text = tuple(textwrap.wrap(_plain(f"Limits: {added.limits}."), _WIDTH))
    yield EffectTable("added_mass", list(_added_mass(added, spec)), text)
    yield EffectTable("added_mass_coupling", list(_couplings(added, spec)))
    if turns:
        yield EffectTable("added_mass_coriolis", [])
    yield EffectTable("linear_damping", list(_linear_drag(mesh, drag, spec)))
    yield EffectTable("quadratic_damping", list(_quadratic_drag(drag, spec)))
    if {"heave", "roll", "pitch"} & set(spec.degrees_of_freedom):
        text = ("Weight and centre of gravity are those of rigid_body.",)
        yield EffectTable("restoring", list(_restoring(mesh, spec)), text)


def _rigid_body(mesh: Mesh, spec: HullSpec) -> Iterator[str]:
    yield entry_line("m", spec.mass, "kg", source="as stated")
    for axis, arm in zip("xyz", spec.cg, strict=True):
        if arm:
            yield entry_line(f"{axis}_g", arm, "m", source=spec.cg_source)
    cg = np.array(spec.cg)
    inertia = mesh.inertia * spec.mass / mesh.volume + spec.mass * (cg @ cg * np.eye(3) - np.outer(cg, cg))
    source = "assumed: mass spread evenly over the hull"
    yield from _tensor(inertia, "", spec, source)


def _tensor(inertia: Array, suffix: str, spec: HullSpec, source: str) -> Iterator[str]:
    turning = [i - 3 for i in spec.own if i > 2]
    for i in turning:
        value = float(inertia[i, i])
        sigma = _RULES.inertia * value
        yield entry_line(f"I_{'xyz'[i]}{suffix}", value, "kg m^2", sigma=sigma, source=source)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        product = -float(inertia[i, j])
        if {i, j} <= set(turning) and abs(product) > _RULES.rounding * np.trace(inertia):
            sigma = _RULES.inertia * float(np.sqrt(inertia[i, i] * inertia[j, j]))
            name = f"I_{'xyz'[i]}{'xyz'[j]}{suffix}"
            yield entry_line(name, product, "kg m^2", sigma=sigma, source=source)


def _water(mesh: Mesh, spec: HullSpec, volume: float) -> Iterator[str]:
    mass = spec.density * (mesh.volume - volume)
    source = "assumed: water fills what the hull encloses and does not displace, evenly"
    yield entry_line("m_w", mass, "kg", sigma=_RULES.inertia * mass, source=source)
    for axis, arm in zip("xyz", mesh.centroid, strict=True):
        if abs(arm) > _RULES.rounding * mesh.extents.max():
            yield entry_line(f"m{axis}_w", mass * float(arm), "kg m", source=source)
    centre = mesh.centroid
    about = mesh.inertia / mesh.volume + centre @ centre * np.eye(3) - np.outer(centre, centre)
    yield from _tensor(mass * about, "w", spec, source)


def _added_mass(added: AddedMass, spec: HullSpec) -> Iterator[str]:
    sigma = sigma_of(added)
    for i in spec.own:
        value, spread = entry(added, i, i), float(sigma[i, i])
        yield entry_line(
            derivative(i, i), -value, _UNITS["m"][i > 2], sigma=spread, estimate=True, source=added.source
        )


def _couplings(added: AddedMass, spec: HullSpec) -> Iterator[str]:
    sigma = sigma_of(added)
    for i, j in coupled(added.matrix):
        if {i, j} <= set(spec.own):
            unit = ("kg", "kg m", "kg m^2")[(i > 2) + (j > 2)]
            value, spread = float(added.matrix[i, j]), float(sigma[i, j])
            yield entry_line(derivative(i, j), -value, unit, sigma=spread, source=added.source)


def _linear_drag(mesh: Mesh, drag: Drag, spec: HullSpec) -> Iterator[str]:
    for i in spec.own:
        even = _RULES.even_speed if i < 3 else _RULES.even_speed / (float(mesh.extents.max()) / 2)
        value = float(drag.coefficients[i]) * even
        unit = "m/s" if i < 3 else "rad/s"
        text = f"assumed: as much as the quadratic drag at {even:.2g} {unit}"
        name = f"{FORCE[i]}_{VELOCITY[i]}"
        yield entry_line(name, -value, _UNITS["d"][i > 2], sigma=value, estimate=True, source=text)


def _quadratic_drag(drag: Drag, spec: HullSpec) -> Iterator[str]:
    for i in spec.own:
        value, sigma = float(drag.coefficients[i]), float(drag.sigma[i])
        name = f"{FORCE[i]}_{VELOCITY[i]}abs{VELOCITY[i]}"
        source = drag.sources[i]
        yield entry_line(name, -value, _UNITS["q"][i > 2], sigma=sigma, estimate=True, source=source)


def _restoring(mesh: Mesh, spec: HullSpec) -> Iterator[str]:
    volume = mesh.volume if spec.volume is None else spec.volume
    buoyancy = spec.density * ENVIRONMENT.gravity * volume
    text = "volume of the hull" if spec.volume is None else "volume as stated"
    source = f"{text}, {volume:.5g} m^3, times density and gravity"
    yield entry_line("B", buoyancy, "N", sigma=_RULES.buoyancy * buoyancy, estimate=True, source=source)
    centre = np.where(np.abs(mesh.centroid) > _RULES.rounding * mesh.extents.max(), mesh.centroid, 0.0)
    for axis, arm in zip("xyz", centre, strict=True):
        yield entry_line(f"{axis}_b", float(arm), "m", source="centre of volume of the hull")


# --- text -----------------------------------------------------------------------------------------
def entry_line(
    name: str,
    value: float,
    unit: str,
    *,
    backward: float | None = None,
    sigma: float = 0.0,
    estimate: bool = False,
    assumed: bool = False,
    source: str,
) -> str:
    """One parameter of a table, as a line of the file; `backward`: its value backward, if another.

    A source that says "assumed" marks the value as assumed.
    """
    # What is zero by symmetry, and known to be so, leaves nothing to be estimated.
    open_ = bool(value) or sigma > _RULES.rounding
    ways = {"value": value} if backward is None else {"forward": value, "backward": backward}
    fields = [f"{way} = {_quoted(f'{0.0 + number:.6g} {unit}')}" for way, number in ways.items()]
    fields += ["assumed = true"] if assumed or source.startswith("assumed:") else []
    fields += ["estimate = true"] if estimate and open_ else []
    fields += [f"sigma = {_quoted(f'{sigma:.3g} {unit}')}"] if sigma and open_ else []
    return f"{name} = {{ {', '.join([*fields, f'source = {_quoted(source)}'])} }}"


def _quoted(text: str) -> str:
    return tomlkit.item(text).as_string()


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def motions(names: Sequence[str]) -> tuple[str, ...]:
    """Degrees of freedom in their order."""
    wrong = [n for n in names if n not in DOFS]
    if wrong or not names:
        found = f"'{wrong[0]}'" if wrong else "nothing"
        raise UndertowError(f"degrees of freedom: found {found}; choose from {', '.join(DOFS)}")
    return tuple(d for d in DOFS if d in names)
