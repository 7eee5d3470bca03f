"""No number of a vehicle, gain, observer or mission file is in the functions of exported C."""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.codegen.support import named_vehicle, random_parameters, vehicle_with
from tests.observer.test_design import behind
from tests.quick import first_quick
from undertow.codegen import Functions
from undertow.codegen.compiler import Compiler, pointer
from undertow.codegen.library import Library
from undertow.control.gains import load_gains
from undertow.control.guidance.line_of_sight import Guidance
from undertow.control.guidance.mission import load_mission
from undertow.control.guidance.reference import Limits
from undertow.control.plant import Plant
from undertow.control.update import library_of
from undertow.model.effect import Curve, Law, Propeller, Surface
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.tables import bundled_curves
from undertow.model.vehicle import Thruster, Value, Vehicle
from undertow.observer.filters import Method
from undertow.observer.process import process_of

_DEFAULTS = re.compile(r"^const \w+ \w+_default = \{.*?\};\n", re.DOTALL | re.MULTILINE)
_COMMENTS = re.compile(r"/\*.*?\*/", re.DOTALL)
Change = Callable[[float], float]


def other(v: float) -> float:
    """Another number in the place of one; of zero, too."""
    return 1.0137 * v + 0.0123


def functions_in(library: Library) -> dict[str, str]:
    """Sources without comments and without the values of structs."""
    sources = {n: t for n, t in library.texts.items() if n.startswith("src/") and n.endswith(".c")}
    return {n: _DEFAULTS.sub("", _COMMENTS.sub("", t)) for n, t in sources.items()}


def with_other_numbers(vehicle: Vehicle, change: Change = other) -> Vehicle:
    """The vehicle with another value of everything that its file states or could state."""
    hardware = {*vehicle.environment, *(f"thrust_{t.name}" for t in vehicle.thrusters)}
    names = {n: vehicle.value_of(n) for n in vehicle.parameter_names if n not in hardware}
    return replace(
        vehicle,
        values={n: replace(v, value=change(v.value)) for n, v in (names | dict(vehicle.values)).items()},
        environment={n: change(v) for n, v in vehicle.environment.items()},
        thrusters=tuple(_thruster(t, change) for t in vehicle.thrusters),
        surfaces=tuple(_surface(s, change) for s in vehicle.surfaces),
    )


def _thruster(t: Thruster, change: Change) -> Thruster:
    push = replace(t.thrust_per_command, value=change(t.thrust_per_command.value))
    law, ahead = _law(t.law, change), t.wrench[0]
    e = (change(ahead) if ahead else 0.0, *map(change, t.wrench[1:3]))  # a rudder stays one
    if t.position is None:
        wrench = (*e, *map(change, t.wrench[3:]))
        return replace(t, wrench=wrench, thrust_per_command=push, law=law)
    place = tuple(map(change, t.position))
    wrench = (*e, *np.cross(place, e).tolist())
    return replace(t, wrench=wrench, position=place, thrust_per_command=push, law=law)


def _law(law: Law, change: Change) -> Law:
    if isinstance(law, Propeller):
        return Propeller(change(law.diameter), change(law.per_command))
    if isinstance(law, Curve):
        pieces = [(change(a), change(b), tuple(map(change, c))) for a, b, c in law.pieces]
        return Curve(change(law.start), tuple(pieces))
    return law


def _surface(s: Surface, change: Change) -> Surface:
    return replace(
        s,
        position=tuple(map(change, s.position)),
        axis=(0.0, change(s.axis[1]), change(s.axis[2])),
        area=change(s.area),
        limit=None if s.limit is None else change(s.limit),
        diameter=change(s.diameter) if s.propeller else s.diameter,
    )


def vehicle_of(name: str) -> Vehicle:
    """A bundled vehicle, one with every effect, or one with a thruster's curve from a bench test."""
    if name == "full":
        return named_vehicle(name)
    if name == "hardware":  # of every kind, moments stated in the place of positions, and density and gravity
        bare = vehicle_with("steering_gear", "reaction_torque", "waves")
        f = Functions(bare)
        values = zip(f.parameter_names, random_parameters(f, 8), strict=True)
        return bare.with_values({n: Value(v) for n, v in values if n not in bare.environment})
    if name != "mini-auv, T200":
        return load_vehicle(name)
    auv = load_vehicle("mini-auv")
    lines = bundled_curves()["t200-16v"].read_text().splitlines()
    rows = np.loadtxt([line for line in lines if line[:1] in "-0123456789"], delimiter=",")
    curve = Curve.through([(float(a), float(b)) for a, b in rows[::20]])
    return replace(auv, thrusters=tuple(replace(t, law=curve) for t in auv.thrusters))


NAMES = ("remus100", "kvlcc2", "mini-auv, T200", *bundled_vehicles(), "full")


@pytest.mark.parametrize("name", first_quick(list(dict.fromkeys(NAMES)), 3))
def test_functions_do_not_change_with_the_numbers_of_the_vehicle(name: str) -> None:
    vehicle = vehicle_of(name)
    before, after = functions_in(Library(vehicle)), functions_in(Library(with_other_numbers(vehicle)))
    assert before.keys() >= {f"src/{Library(vehicle).name}_vehicle.c"}
    for file in before.keys() & after.keys():  # the curve with other numbers may have no inverse
        assert before[file] == after[file], file


@pytest.mark.parametrize("name", first_quick([*dict.fromkeys(NAMES[:-1]), "hardware"], 3))
def test_the_struct_with_other_numbers_is_the_vehicle_with_them(
    name: str, c_compiler: Compiler, tmp_path: Path
) -> None:
    """Places, directions, propellers, curves, density and gravity: as a file that states them would say."""
    vehicle = vehicle_of(name)
    library, changed = Library(vehicle), with_other_numbers(vehicle, lambda v: 1.03 * v + 1e-3)
    built, members = _built(library, c_compiler, tmp_path), library.manifest.parameters
    stated = {e.name: e.value for e in Library(changed).manifest.parameters}
    assert {e.name for e in members} == stated.keys()
    p = np.array([stated[e.name] for e in members])
    kept = {e.name for e, v in zip(members, p, strict=True) if v == e.value}
    assert all(n.startswith("e_x_") for n in kept)
    f, rng = Functions(changed), np.random.default_rng(4)
    for _ in range(3):
        x, u = rng.normal(size=f.x.numel()), rng.normal(size=f.u.numel())
        found = np.full(x.size, np.nan)
        built(*map(pointer, (x, u, p)), ctypes.c_double(0.3), pointer(found))
        expected = np.asarray(f.dynamics(x, u, f.values(), 0.3)).ravel()
        assert np.isfinite(expected).all()
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


MISSIONS = Path(__file__).parents[2] / "examples" / "missions"


@pytest.mark.parametrize(
    ("vehicle", "gains", "mission"),
    first_quick(
        [
            ("remus100", "remus100-gains", "remus100-survey"),
            ("bluerov2", "bluerov2-gains", "bluerov2-spline"),
        ],
    ),
)
def test_functions_do_not_change_with_the_numbers_of_gains_and_mission(
    vehicle: str, gains: str, mission: str
) -> None:
    """Gains, what the law assumes of the vehicle, allocation, limits, way-points and guidance."""
    model, way = load_vehicle(vehicle), load_mission(MISSIONS / f"{mission}.toml")
    law = load_gains(MISSIONS / f"{gains}.toml", model)
    scaled_model = with_other_numbers(model, scaled)
    stated = {n: scaled_model.values[n] for n in model.values}  # what the file leaves out is not in the law
    limits = {n: change_size(q) for n, q in law.allocation.limits.items()}
    weights = dict.fromkeys(law.plant.vehicle.command_names, 1.7)
    changed = replace(
        law,
        values={n: other(v) if v else v for n, v in law.values.items()},  # an axis without gains is no number
        plant=Plant(replace(scaled_model, values=stated), 1.3 * law.plant.speed),
        allocation=law.allocation.model_copy(update={"limits": limits, "weights": weights}),
    )
    longer = replace(
        way,
        points=1.1 * way.points,
        limits=Limits(*(1.1 * v for v in vars(way.limits).values())),
        guidance=Guidance(*(1.1 * v for v in vars(way.guidance).values())),
    )
    before = functions_in(library_of(model, [law], mission=way))
    after = functions_in(library_of(model, [changed], mission=longer))
    name = f"src/{model.name}_{law.name.replace('-', '_')}.c"
    assert before[name] == after[name]


def scaled(v: float) -> float:
    """Another number, zero where it was: what is zero in an allocation stays zero there."""
    return 1.0137 * v


def change_size(quantity: object) -> object:
    """A tenth more of a quantity with or without a unit."""
    if isinstance(quantity, str):
        number, unit = quantity.split(" ", 1)
        return f"{1.1 * float(number)} {unit}"
    return 1.1 * quantity  # type: ignore[operator]


@pytest.mark.parametrize("method", first_quick(["ekf", "ukf"]))
def test_functions_do_not_change_with_the_numbers_of_an_observer(method: Method) -> None:
    """Vehicle, noise, disturbance and the age of late reports; how many steps are kept is a size."""
    design = behind(method)
    process = process_of(with_other_numbers(design.process.vehicle, slower), design.process.estimated)
    changed = replace(design, process=process, variance=1.3 * design.variance, densities=2 * design.densities)
    before, after = (functions_in(library_of(load_vehicle("mini-auv"), [], [d])) for d in (design, changed))
    (name,) = (n for n in before if "_late_" in n)
    assert before[name] == after[name]


def slower(v: float) -> float:
    """Another number, with a delay that needs as many steps as before."""
    return 0.99 * v if v else 1e-6


def _built(library: Library, compiler: Compiler, place: Path) -> Any:
    folder, name = library.write(place).folder, library.name
    command = [*compiler.command, "-std=c99", "-O1", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([*command, f"src/{name}_vehicle.c", "-lm", "-o", "it.so"], cwd=folder, check=True)
    return getattr(ctypes.CDLL(str(folder / "it.so")), f"{name}_dynamics")
