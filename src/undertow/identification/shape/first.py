"""A first vehicle file from the shape of a hull: each value with where it is from and how far to trust it."""

from __future__ import annotations

import textwrap
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomlkit
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import ValidationError

from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.loading import vehicle_from_table
from undertow.model.symbols import DOFS, FORCE, VELOCITY
from undertow.model.vehicle_schema import VehicleTable
from undertow.typing import Array

from .bodies import AddedMass
from .drag import Drag, drag_of_hull
from .mesh import Mesh
from .priors import coupled, derivative, entry, sigma_of

GRAVITY = 9.81
_WIDTH = 110
# What the volume of a drawing misses of a real vehicle: hollows, cables, foam that is compressed.
_BUOYANCY_SHARE = 0.02
_INERTIA_SHARE = 0.3
# Speed at which linear drag is assumed to equal quadratic drag, m/s.
_EVEN_SPEED = 0.1
# Products of inertia and arms below this share of the size are rounding.
_NOTHING = 1e-6
_UNITS = {"m": ("kg", "kg m^2"), "d": ("kg/s", "kg m^2/s"), "q": ("kg/m", "kg m^2")}


@dataclass(frozen=True)
class Wish:
    """What a first vehicle is to be.

    Attributes
    ----------
    name : str
        Of the vehicle.
    mesh : str
        File of the hull, for the record.
    sha256 : str
        Of that file.
    mass : float
        kg.
    density : float
        Of the water, kg/m^3.
    cg : (3,) tuple of float
        Centre of gravity from the origin, m, body axes.
    degrees_of_freedom : tuple of str
        Motions that the model has.
    origin : (3,) array
        Origin of the vehicle in the coordinates of the mesh, m.
    cd : (3,) tuple of float, optional
        Drag coefficients along x, y and z; by the form of the hull if None.
    volume : float, optional
        What the hull displaces if water gets into it, m^3; what it encloses if None.
    remarks : tuple of str
        What else a reader of the file should know.
    """

    name: str
    mesh: str
    sha256: str
    mass: float
    density: float
    cg: tuple[float, float, float]
    degrees_of_freedom: tuple[str, ...]
    origin: Array
    cd: tuple[float, float, float] | None = None
    volume: float | None = None
    remarks: tuple[str, ...] = ()

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


def first_vehicle(hull: Mesh, added: AddedMass, wish: Wish) -> str:
    """The text of a vehicle file for a hull.

    Parameters
    ----------
    hull : Mesh
        In body axes, with the origin of the file of the hull.
    added : AddedMass
        Of the hull, about the same origin.
    wish : Wish
        What else is known.

    Raises
    ------
    UndertowError
        If mass, density or volume are not positive, the hull displaces more than it encloses, or no vehicle
        can be made of it all.
    """
    _check(hull, wish)
    mesh, added = hull.moved(-wish.origin), added.placed(np.eye(3), -wish.origin)
    drag = drag_of_hull(mesh, wish.density, cd=wish.cd)
    tables = [t for t in _tables(mesh, added, drag, wish) if t.entries or t.id.endswith("_coriolis")]
    text = _template().render(
        mesh=_plain(wish.mesh),
        sha256=wish.sha256,
        about=[part for line in _about(mesh, wish) for part in textwrap.wrap(_plain(line), _WIDTH)],
        name=_quoted(wish.name),
        description=_quoted(f"First model of {wish.name} from its hull ({_size(mesh)}, {wish.mass:g} kg)"),
        source=_quoted(f"shape of {wish.mesh}, mass as stated; no test yet"),
        degrees_of_freedom=[_quoted(d) for d in wish.degrees_of_freedom],
        water_density=_quoted(f"{wish.density:g} kg/m^3"),
        forces=[_quoted(f"tau_{FORCE[i]}") for i in wish.own],
        effects=tables,
    )
    try:
        vehicle_from_table(VehicleTable.model_validate(tomllib.loads(text)), catalogue())
    except ValidationError as error:
        raise UndertowError(f"no vehicle file can be made of it: {error.errors()[0]['msg']}") from error
    return str(text).rstrip() + "\n"


def _template() -> Any:
    environment = Environment(
        loader=PackageLoader("undertow.identification.shape"),
        autoescape=False,  # TOML, not HTML: texts are quoted by tomlkit, comments made harmless by `_plain`
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("vehicle.txt")


def _check(hull: Mesh, wish: Wish) -> None:
    for what, value, unit in (("mass", wish.mass, "kg"), ("density", wish.density, "kg/m^3")):
        if not (value > 0 and np.isfinite(value)):
            raise UndertowError(f"{what} = {value:g} {unit} cannot be: give a positive number")
    if wish.volume is not None and not 0 < wish.volume <= hull.volume * 1.001:
        raise UndertowError(
            f"volume = {wish.volume:g} m^3 cannot be: the hull encloses {hull.volume:.4g} m^3, and water "
            "that gets in leaves less"
        )


def _about(mesh: Mesh, wish: Wish) -> Iterator[str]:
    surface = float(mesh.areas.sum())
    yield f"The hull is {_size(mesh)}, encloses {mesh.volume:.6g} m^3 and has {surface:.4g} m^2 of surface."
    x, y, z = wish.origin
    yield (
        f"The origin is at ({x:.5g}, {y:.5g}, {z:.5g}) m of the mesh; axes: x forward, y to starboard, "
        "z down."
    )
    yield from wish.remarks


def _size(mesh: Mesh) -> str:
    return " x ".join(f"{e:.4g}" for e in mesh.extents) + " m"


# --- effects --------------------------------------------------------------------------------------
def _tables(mesh: Mesh, added: AddedMass, drag: Drag, wish: Wish) -> Iterator[EffectTable]:
    turns = len(wish.own) > 1
    yield EffectTable("rigid_body", list(_rigid_body(mesh, wish)))
    if turns:
        yield EffectTable("rigid_body_coriolis", [])
    if wish.volume is not None:
        yield EffectTable("entrained_water", list(_water(mesh, wish, wish.volume)))
    told = tuple(textwrap.wrap(_plain(f"Limits: {added.limits}."), _WIDTH))
    yield EffectTable("added_mass", list(_added_mass(added, wish)), told)
    yield EffectTable("added_mass_coupling", list(_couplings(added, wish)))
    if turns:
        yield EffectTable("added_mass_coriolis", [])
    yield EffectTable("linear_damping", list(_linear_drag(mesh, drag, wish)))
    yield EffectTable("quadratic_damping", list(_quadratic_drag(drag, wish)))
    if {"heave", "roll", "pitch"} & set(wish.degrees_of_freedom):
        told = ("Weight and centre of gravity are those of rigid_body.",)
        yield EffectTable("restoring", list(_restoring(mesh, wish)), told)


def _rigid_body(mesh: Mesh, wish: Wish) -> Iterator[str]:
    yield _entry("m", wish.mass, "kg", source="as stated")
    for axis, arm in zip("xyz", wish.cg, strict=True):
        if arm:
            yield _entry(f"{axis}_g", arm, "m", source="as stated")
    cg = np.array(wish.cg)
    inertia = mesh.inertia * wish.mass / mesh.volume + wish.mass * (cg @ cg * np.eye(3) - np.outer(cg, cg))
    source = "assumed: mass spread evenly over the hull"
    yield from _tensor(inertia, "", wish, source)


def _tensor(inertia: Array, suffix: str, wish: Wish, source: str) -> Iterator[str]:
    turning = [i - 3 for i in wish.own if i > 2]
    for i in turning:
        value = float(inertia[i, i])
        sigma = _INERTIA_SHARE * value
        yield _entry(f"I_{'xyz'[i]}{suffix}", value, "kg m^2", sigma=sigma, assumed=True, source=source)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        product = -float(inertia[i, j])
        if {i, j} <= set(turning) and abs(product) > _NOTHING * np.trace(inertia):
            sigma = _INERTIA_SHARE * float(np.sqrt(inertia[i, i] * inertia[j, j]))
            name = f"I_{'xyz'[i]}{'xyz'[j]}{suffix}"
            yield _entry(name, product, "kg m^2", sigma=sigma, assumed=True, source=source)


def _water(mesh: Mesh, wish: Wish, volume: float) -> Iterator[str]:
    mass = wish.density * (mesh.volume - volume)
    source = "assumed: water fills what the hull encloses and does not displace, evenly"
    yield _entry("m_w", mass, "kg", sigma=_INERTIA_SHARE * mass, assumed=True, source=source)
    for axis, arm in zip("xyz", mesh.centroid, strict=True):
        if abs(arm) > _NOTHING * mesh.extents.max():
            yield _entry(f"m{axis}_w", mass * float(arm), "kg m", assumed=True, source=source)
    centre = mesh.centroid
    about = mesh.inertia / mesh.volume + centre @ centre * np.eye(3) - np.outer(centre, centre)
    yield from _tensor(mass * about, "w", wish, source)


def _added_mass(added: AddedMass, wish: Wish) -> Iterator[str]:
    sigma = sigma_of(added)
    for i in wish.own:
        value, spread = entry(added, i, i), float(sigma[i, i])
        yield _entry(
            derivative(i, i), -value, _UNITS["m"][i > 2], sigma=spread, estimate=True, source=added.source
        )


def _couplings(added: AddedMass, wish: Wish) -> Iterator[str]:
    sigma = sigma_of(added)
    for i, j in coupled(added.matrix):
        if {i, j} <= set(wish.own):
            unit = ("kg", "kg m", "kg m^2")[(i > 2) + (j > 2)]
            value, spread = float(added.matrix[i, j]), float(sigma[i, j])
            yield _entry(derivative(i, j), -value, unit, sigma=spread, source=added.source)


def _linear_drag(mesh: Mesh, drag: Drag, wish: Wish) -> Iterator[str]:
    for i in wish.own:
        even = _EVEN_SPEED if i < 3 else _EVEN_SPEED / (float(mesh.extents.max()) / 2)
        value = float(drag.coefficients[i]) * even
        unit = "m/s" if i < 3 else "rad/s"
        told = f"assumed: as much as the quadratic drag at {even:.2g} {unit}"
        name = f"{FORCE[i]}_{VELOCITY[i]}"
        yield _entry(name, -value, _UNITS["d"][i > 2], sigma=value, estimate=True, assumed=True, source=told)


def _quadratic_drag(drag: Drag, wish: Wish) -> Iterator[str]:
    for i in wish.own:
        value, sigma = float(drag.coefficients[i]), float(drag.sigma[i])
        name = f"{FORCE[i]}_{VELOCITY[i]}abs{VELOCITY[i]}"
        source = drag.sources[i]
        yield _entry(name, -value, _UNITS["q"][i > 2], sigma=sigma, estimate=True, source=source)


def _restoring(mesh: Mesh, wish: Wish) -> Iterator[str]:
    volume = mesh.volume if wish.volume is None else wish.volume
    buoyancy = wish.density * GRAVITY * volume
    told = "volume of the hull" if wish.volume is None else "volume as stated"
    source = f"{told}, {volume:.5g} m^3, times density and gravity"
    yield _entry("B", buoyancy, "N", sigma=_BUOYANCY_SHARE * buoyancy, estimate=True, source=source)
    centre = np.where(np.abs(mesh.centroid) > _NOTHING * mesh.extents.max(), mesh.centroid, 0.0)
    for axis, arm in zip("xyz", centre, strict=True):
        yield _entry(f"{axis}_b", float(arm), "m", source="centre of volume of the hull")


# --- text -----------------------------------------------------------------------------------------
def _entry(
    name: str,
    value: float,
    unit: str,
    *,
    sigma: float = 0.0,
    estimate: bool = False,
    assumed: bool = False,
    source: str,
) -> str:
    # What is zero by symmetry, and known to be so, leaves nothing to be estimated.
    open_ = bool(value) or sigma > _NOTHING
    fields = [f"value = {_quoted(f'{0.0 + value:.6g} {unit}')}"]
    fields += ["assumed = true"] if assumed else []
    fields += ["estimate = true"] if estimate and open_ else []
    fields += [f"sigma = {_quoted(f'{sigma:.3g} {unit}')}"] if sigma and open_ else []
    return f"{name} = {{ {', '.join([*fields, f'source = {_quoted(source)}'])} }}"


def _quoted(text: str) -> str:
    return tomlkit.item(text).as_string()


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def motions(names: Sequence[str]) -> tuple[str, ...]:
    """Degrees of freedom in their order.

    Raises
    ------
    UndertowError
        If one is not known, or there is none.
    """
    wrong = [n for n in names if n not in DOFS]
    if wrong or not names:
        found = f"'{wrong[0]}'" if wrong else "nothing"
        raise UndertowError(f"degrees of freedom: found {found}; choose from {', '.join(DOFS)}")
    return tuple(d for d in DOFS if d in names)
