"""A first vehicle file from a type of vehicle and its main dimensions, by rules with their sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import log10, pi, sqrt

import numpy as np

from undertow.errors import UndertowError
from undertow.model.symbols import ENVIRONMENT
from undertow.typing import Array

from .bodies import AddedMass, box, ellipsoid, equivalent, positive
from .hull_vehicle import EffectTable, Hardware, HullSpec, entry_line, hull_tables, vehicle_text
from .mesh import Faces, Mesh


@dataclass(frozen=True)
class TypeRules:
    """What is taken for granted of a type; places and areas are shares of the size, sigmas of the value."""

    # centre of gravity below that of buoyancy, of the height: BlueROV2 0.08, REMUS 0.10
    low_weight: float = 0.09
    trim: float = 0.01  # sigma of the buoyancy of a vehicle that was trimmed to float
    frame: float = 0.5  # sigma of added mass of open frames: three published sets of BlueROV2 differ as much
    # ROV thrusters of BlueROV2, over length, beam and height: four at 45 degrees, two or four upright
    vectored: tuple[float, float, float] = (0.34, 0.33, 0.33)
    upright: tuple[float, float] = (0.26, 0.38)
    # one pair of fins of REMUS 100: area over length times diameter, effective aspect ratio, place over
    # length, and what Prestero found of the force that this gives
    fin_area: float = 0.052
    fin_share: float = 0.45
    fin_aspect: float = 2.2
    fin_place: float = -0.48
    fin: float = 0.5  # sigma of forces of fins, of which a hull leaves more or less
    body_lift: float = 0.003  # side force of a body per degree and length over diameter (Hoerner 1965)
    body_lift_place: float = -0.15  # where it acts: 0.65 of the length behind the nose (Hoerner 1965)
    wing_area: float = 0.03  # of the length squared, as those of a Slocum are
    wing_span: float = 0.67
    wing: float = 0.5  # sigma of the lift of wings whose plan is not known
    # Exponents of the profile of a hull that is as full as its mass asks for, and how many are tried.
    profile: tuple[float, float] = (0.8, 30.0)
    profiles: int = 200
    block: tuple[float, float] = (0.1, 0.98)  # displacement over length times beam times draught
    # The least of two hulls over their overall beam, assumed: half of the 0.093 of a very slim and wide
    # catamaran, hulls of L/b = 15 and block coefficient 0.4, half a length apart.
    block_of_two: float = 0.045
    # Length over beam of ships from which Clarke's regression was made, at least; others are small craft.
    slender: float = 4.0
    gyration: float = 0.25  # radius of gyration in yaw over length (Fossen 2021: 0.25 for small vessels)
    inertia: float = 0.2  # sigma of the moment of inertia that follows
    regression: float = 0.3  # sigma of Clarke's regression for ships
    # small craft, by the model of the Otter in MSS: added mass across over mass, in yaw over inertia, and
    # time constants of sway and yaw of a craft of 2 m
    small_added: tuple[float, float] = (1.5, 1.7)
    small_time: float = 1.0
    small: float = 0.6  # sigma of these
    froude: float = 0.2  # at which friction is taken
    resistance: float = 1.4  # total over plate friction: form, waves and appendages
    resistance_sigma: float = 0.4
    # section drag coefficient: Hoerner has 0.6 to 1.0 for beam over draught of 6 to 1.5
    crossflow: float = 0.8
    crossflow_sigma: float = 0.4
    rudder_aspect: float = 1.5
    rudder_hull: float = 0.3  # force on the hull per force on the rudder, a_H: KVLCC2 0.312
    rudder_deduction: float = 0.4  # t_R: KVLCC2 0.387
    straightening: float = 0.5  # gamma_R: KVLCC2 0.395 and 0.640
    rudder: float = 0.5  # sigma: slipstream and wake are not known
    propellers: tuple[float, float] = (-0.5, 0.37)  # of a craft with two, over length and beam: Otter
    azimuth: float = 0.36  # place of azimuth thrusters over length, assumed: nothing published was checked


_RULES = TypeRules()
_SIX = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_SHIP = ("surge", "sway", "yaw")


@dataclass(frozen=True)
class MainDimensions:
    """Size of a vehicle."""

    length: float  # m
    beam: float  # m
    height: float  # m; the draught of a ship or surface craft
    mass: float  # kg, ready to go
    density: float = 1025.0  # of the water, kg/m^3

    @property
    def displaced(self) -> float:
        """Volume of water as heavy as the vehicle, m^3."""
        return self.mass / self.density


def typed_vehicle(kind: str, size: MainDimensions, name: str, motions: tuple[str, ...] | None = None) -> str:
    """The text of a complete vehicle file for a vehicle of a type, one of `TYPES`, in some of its motions."""
    positive(**vars(size))
    about, own, tables, hardware = TYPES[kind](size)
    dofs = own if motions is None else motions
    if foreign := [d for d in dofs if d not in own]:
        raise UndertowError(f"--type {kind} has no {', '.join(foreign)}: choose from {', '.join(own)}")
    surfaces = [h.name for h in hardware if not h.at_rest and h.acts_in(dofs)]
    if surfaces and "surge" not in dofs:
        raise UndertowError(
            f"--dof {','.join(dofs)} leaves out surge, without whose speed '{surfaces[0]}' makes no force: "
            f"give --dof {','.join(['surge', *dofs])}; of a log without a speed, state a constant one as u "
            "under [channels] in the mapping file"
        )
    extents = f"{size.length:g} x {size.beam:g} x {size.height:g} m"
    return vehicle_text(
        made_from=f"the type {kind}, {extents} and {size.mass:g} kg",
        about=[about, "Numbers marked as assumed are rules of thumb for the type: no drawing, no test."],
        name=name,
        description=f"First model of {name}: {kind}, {extents}, {size.mass:g} kg",
        source="rules for the type, each named at its value; no test yet",
        degrees_of_freedom=dofs,
        density=size.density,
        tables=tables,
        hardware=hardware,
    )


def _guess(name: str, value: float, unit: str, sigma: float, source: str) -> str:
    """A value of a rule, to be estimated from logs."""
    return entry_line(name, value, unit, sigma=sigma, estimate=True, assumed=True, source=source)


Made = tuple[str, tuple[str, ...], list[EffectTable], list[Hardware]]


# --- hulls under water ----------------------------------------------------------------------------
def _submerged(size: MainDimensions, mesh: Mesh, added: AddedMass) -> list[EffectTable]:
    """Tables of a hull that floats where it is put, by the shape of a simple body."""
    low = _RULES.low_weight * size.height
    spec = HullSpec(
        name="",
        mesh="",
        sha256="",
        mass=size.mass,
        density=size.density,
        cg=(0.0, 0.0, low),
        cg_source=f"assumed: {_RULES.low_weight:g} of the height below the centre of buoyancy",
        degrees_of_freedom=_SIX,
        origin=np.zeros(3),
    )
    weight = size.mass * ENVIRONMENT.gravity
    text = "assumed: trimmed to float, as heavy as the vehicle"
    afloat = _guess("B", weight, "N", _RULES.trim * weight, text)
    tables = [t for t in hull_tables(mesh, added, spec) if t.id != "restoring"]
    notes = ("Weight and centre of gravity are those of rigid_body; the origin is the centre of buoyancy.",)
    return [*tables, EffectTable("restoring", [afloat], notes)]


def _rov(size: MainDimensions, upright: list[tuple[float, float]]) -> Made:
    if size.displaced > size.length * size.beam * size.height:
        raise UndertowError(
            f"mass = {size.mass:g} kg sinks: a box of these dimensions displaces "
            f"{size.density * size.length * size.beam * size.height:.4g} kg at most; correct one of them"
        )
    tables = _submerged(size, _box(size), _open_frame_added_mass(size))
    x, y, z = np.array(_RULES.vectored) * (size.length, size.beam, size.height)
    source = "assumed: places of BlueROV2, scaled to the dimensions; 45 degrees"
    level = [
        Hardware(
            f"h{k + 1}", (float(i * x), float(j * y), float(z)), (i * sqrt(0.5), -j * sqrt(0.5), 0.0), source
        )
        for k, (i, j) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    ]
    down = [
        Hardware(f"v{k + 1}", (i * size.length, j * size.beam, 0.0), (0.0, 0.0, 1.0), source)
        for k, (i, j) in enumerate(upright)
    ]
    about = f"An open frame with four vectored and {len(down)} upright thrusters; commands are thrusts in N."
    return about, _SIX, tables, [*level, *down]


def _rov6(size: MainDimensions) -> Made:
    return _rov(size, [(0.0, _RULES.vectored[1]), (0.0, -_RULES.vectored[1])])


def _rov8(size: MainDimensions) -> Made:
    i, j = _RULES.upright
    return _rov(size, [(i, j), (i, -j), (-i, j), (-i, -j)])


def _box(size: MainDimensions) -> Mesh:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return Mesh(corners * (size.length / 2, size.beam / 2, size.height / 2), np.array(faces))


def _open_frame_added_mass(size: MainDimensions) -> AddedMass:
    """Added mass of an open frame: the ellipsoid in its extents, in turning half way to the box."""
    sides = (size.length, size.beam, size.height)
    half = np.array(sides) / 2
    round_ = ellipsoid(half[0], half[1], half[2], size.density).matrix
    matrix = round_.copy()
    matrix[3:, 3:] = (round_ + box(*sides, size.density).matrix)[3:, 3:] / 2
    return AddedMass(
        matrix,
        "assumed: ellipsoid in the extents, in turning the mean of ellipsoid and box",
        "open frames carry less water than their box; this rule gives the published values of BlueROV2",
        _RULES.frame * matrix,
    )


def _torpedo(size: MainDimensions) -> Made:
    mesh = _spindle(size)
    fins = _fin_force(size)
    place = _RULES.fin_place * size.length
    tables = [
        *_submerged(size, mesh, equivalent(mesh, size.density)),
        EffectTable("lift", [*_slender_lift(size, fins, "v"), *_slender_lift(size, fins, "w")]),
        EffectTable("rudder_force", list(_steering(fins, ("rudder", "stern_plane")))),
    ]
    hardware = [
        Hardware("propeller", (-size.length / 2, 0.0, 0.0), (1.0, 0.0, 0.0), "at the tail, on the axis"),
        _surface("rudder", place, (0.0, 1.0, 0.0)),
        _surface("stern_plane", place, (0.0, 0.0, -1.0)),
    ]
    about = (
        "A torpedo with a propeller, rudders and stern planes; commands are thrust in N and angles in rad."
    )
    return about, _SIX, tables, hardware


def _glider(size: MainDimensions) -> Made:
    mesh = _spindle(size)
    fins = _fin_force(size)
    # Lift per angle of attack and speed squared, kg/m: Helmbold's slope with sweep.
    ratio = _RULES.wing_span**2 / _RULES.wing_area
    slope = 2 * pi * ratio / (2 + sqrt(4 + 2 * ratio**2))
    wing, hull = size.density / 2 * _RULES.wing_area * size.length**2 * slope, _body_lift(size)
    plan = f"wings of {_RULES.wing_area:g} L^2 and span {_RULES.wing_span:g} L, swept by 45 degrees"
    arm = _RULES.body_lift_place * size.length
    upright = [
        _guess("Z_uw", -wing - hull, "kg/m", _RULES.wing * wing, f"{plan}, and the hull"),
        _guess(
            "M_uw", hull * arm, "kg", hull * size.length / 4, "the hull at 0.65 of the length; wings at 0"
        ),
    ]
    tables = [
        *_submerged(size, mesh, equivalent(mesh, size.density)),
        EffectTable("lift", [*_slender_lift(size, fins, "v"), *upright]),
        EffectTable("rudder_force", list(_steering(fins, ("rudder",), propeller=False))),
    ]
    about = (
        "A glider with wings and a rudder (rad). What drives it is B - W and the place of its weight (x_g). "
        'If the log has the volume of its buoyancy engine, add inputs = ["B_net"] and a table '
        "[effects.net_buoyancy] before `undertow map new`."
    )
    rudder = _surface("rudder", _RULES.fin_place * size.length, (0.0, 1.0, 0.0))
    return about, _SIX, tables, [rudder]


def _spindle(size: MainDimensions) -> Mesh:
    """A hull with elliptic sections as full as its mass asks for: radius (1 - |2x/L|^n)^(1/n)."""
    # No ring lies at a station of `Mesh.widths`, where a plane through corners would miss their triangles.
    stations, around = 37, 32
    share = size.displaced / (pi / 4 * size.length * size.beam * size.height)
    places = np.cos(np.linspace(pi, 0.0, stations + 1))
    grid = np.geomspace(*_RULES.profile, _RULES.profiles)
    fullness = [_share_of_cylinder(places, n) for n in grid]
    if not fullness[0] <= share <= fullness[-1]:
        low, high = (size.mass / share * f for f in (fullness[0], fullness[-1]))
        raise UndertowError(
            f"mass = {size.mass:g} kg {'rises' if size.mass < low else 'sinks'}: a hull of these dimensions "
            f"displaces {low:.3g} to {high:.3g} kg; correct one of them"
        )
    radius = _profile(places, float(np.interp(share, fullness, grid)))[1:-1]
    angle = 2 * pi * np.arange(around) / around
    rings = np.stack(
        [
            np.repeat(places[1:-1], around),
            np.outer(radius, np.cos(angle)).ravel(),
            np.outer(radius, np.sin(angle)).ravel(),
        ],
        axis=1,
    )
    points = np.vstack([rings, [[-1, 0, 0], [1, 0, 0]]]) * (size.length / 2, size.beam / 2, size.height / 2)
    mesh = Mesh(points, _lathe_faces(len(radius), around))
    return Mesh(points, mesh.faces[:, ::-1]) if mesh.volume < 0 else mesh


def _profile(places: Array, power: float) -> Array:
    return np.asarray((1 - np.abs(places) ** power).clip(0.0) ** (1 / power))


def _share_of_cylinder(places: Array, power: float) -> float:
    """Volume over that of the cylinder around it, of the cones between stations."""
    r = _profile(places, power)
    return float(np.sum(np.diff(places) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2) / 3)) / 2


def _lathe_faces(rings: int, around: int) -> Faces:
    i = np.arange(around)
    j = (i + 1) % around
    stern, bow = rings * around, rings * around + 1
    faces = [np.stack([np.full(around, stern), j, i], axis=1)]
    for k in range(rings - 1):
        a, b = k * around, (k + 1) * around
        faces += [np.stack([a + i, a + j, b + i], axis=1), np.stack([a + j, b + j, b + i], axis=1)]
    last = (rings - 1) * around
    return np.vstack([*faces, np.stack([last + i, last + j, np.full(around, bow)], axis=1)])


def _diameter(size: MainDimensions) -> float:
    return sqrt(size.beam * size.height)


def _fin_force(size: MainDimensions) -> float:
    """Force of a pair of fins per angle and speed squared, kg/m, by Hoerner's slope for low aspect ratios."""
    slope = 1 / (1 / (2 * 0.9 * pi) + 1 / (pi * _RULES.fin_aspect))
    area = _RULES.fin_area * size.length * _diameter(size)
    return size.density / 2 * _RULES.fin_share * area * slope


def _body_lift(size: MainDimensions) -> float:
    """Side force of a body of revolution per drift angle and speed squared, kg/m."""
    per_angle = _RULES.body_lift * 180 / pi * size.length / _diameter(size)
    return size.density / 2 * _diameter(size) ** 2 * per_angle


def _slender_lift(size: MainDimensions, fins: float, across: str) -> Iterator[str]:
    """Lift of hull and tail fins in one plane: level (v and r) or upright (w and q), as Prestero sums it."""
    body, arm = _body_lift(size), _RULES.fin_place * size.length
    force, moment, rate, sign = ("Y", "N", "r", 1.0) if across == "v" else ("Z", "M", "q", -1.0)
    own = body * _RULES.body_lift_place * size.length
    source = "hull: 0.003 per degree and L/d at 0.65 L (Hoerner 1965); fins: slope of low aspect ratio"
    rows = [
        (f"{force}_u{across}", -(body + fins), "kg/m"),
        (f"{moment}_u{across}", -sign * (own + fins * arm), "kg"),
        (f"{force}_u{rate}", -sign * fins * arm, "kg"),
        (f"{moment}_u{rate}", -fins * arm**2, "kg m"),
    ]
    for name, value, unit in rows:
        sigma = _RULES.fin * max(abs(value), 1e-6)
        yield _guess(name, value, unit, sigma, source)


def _steering(fins: float, surfaces: tuple[str, ...], propeller: bool = True) -> Iterator[str]:
    source = f"two fins of {_RULES.fin_area / 2:g} L d each and their force, as REMUS 100 has (Prestero 2001)"
    for name in surfaces:
        yield _guess(f"rudder_{name}", fins, "kg/m", _RULES.fin * fins, source)
    if propeller:
        yield entry_line("rudder_propeller", 0.0, "kg/m", source="a propeller is not a rudder")


def _surface(name: str, place: float, direction: tuple[float, float, float]) -> Hardware:
    limit = "0.349 # rad; assumed: 20 deg, as remus100.m of MSS (Fossen) has it"
    source = "assumed: tail fins as REMUS 100 has them"
    return Hardware(name, (place, 0.0, 0.0), direction, source, at_rest=False, limit=limit)


# --- ships ----------------------------------------------------------------------------------------
def _ship(size: MainDimensions) -> Made:
    slender = size.length >= _RULES.slender * size.beam
    tables = _surface_craft(size, _ship_hull(size) if slender else _small_hull(size))
    area = size.length * size.height / 100 * (1 + 25 * (size.beam / size.length) ** 2)
    slope = 6.13 * _RULES.rudder_aspect / (_RULES.rudder_aspect + 2.25)
    force = size.density / 2 * area * slope
    text = f"{area:.3g} m^2 (rule of DNV: L T / 100 (1 + 25 (B/L)^2)), slope by Fujii: 6.13 A / (A + 2.25)"
    acting = _guess(
        "rudder_rudder",
        force * (1 + _RULES.rudder_hull),
        "kg/m",
        _RULES.rudder * force,
        f"{text}, and a_H = {_RULES.rudder_hull:g}",
    )
    steering = f"{text}, and t_R = {_RULES.rudder_deduction:g}"
    drag = force * (1 - _RULES.rudder_deduction)
    held = [
        _guess("rudder_drag_rudder", drag, "kg/m", _RULES.rudder * force, steering),
        _guess(
            "rudder_inflow_rudder",
            drag * _RULES.straightening,
            "kg/m",
            _RULES.rudder * force,
            f"{steering}, gamma_R = {_RULES.straightening:g}",
        ),
    ]
    none = entry_line("rudder_propeller", 0.0, "kg/m", source="a propeller is not a rudder")
    tables += [EffectTable("rudder_force", [acting, none]), EffectTable("rudder_drag", held)]
    stern = -size.length / 2
    hardware = [
        Hardware("propeller", (stern, 0.0, 0.0), (1.0, 0.0, 0.0), "at the stern, on the centre line"),
        Hardware(
            "rudder",
            (stern, 0.0, 0.0),
            (0.0, -1.0, 0.0),
            "at the stern; positive turns right",
            at_rest=False,
            limit="0.611 # rad; assumed: 35 deg, as SOLAS II-1/29 asks of steering gear",
        ),
    ]
    about = "A ship with one propeller and one rudder; commands are thrust in N and angle in rad."
    return about, _SHIP, tables, hardware


def _asv(size: MainDimensions) -> Made:
    x, y = _RULES.propellers
    source = "assumed: two propellers at the stern, as far apart as those of the Otter"
    hardware = [
        Hardware(name, (x * size.length, side * y * size.beam, 0.0), (1.0, 0.0, 0.0), source)
        for name, side in (("port", -1.0), ("starboard", 1.0))
    ]
    about = "A surface craft that steers by two propellers; commands are thrusts in N."
    return about, _SHIP, _surface_craft(size, _small_hull(size), _RULES.block_of_two), hardware


def _azimuth(size: MainDimensions) -> Made:
    source = f"assumed: on the centre line, {_RULES.azimuth:g} L before and behind amidships"
    hardware = [
        Hardware(f"{end}_{axis}", (place * size.length, 0.0, 0.0), direction, source)
        for end, place in (("bow", _RULES.azimuth), ("stern", -_RULES.azimuth))
        for axis, direction in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)))
    ]
    about = (
        "A surface craft with an azimuth thruster at bow and stern; commands are the thrusts ahead and to "
        "starboard in N. Of a log with thrust and angle: bow_x = 'bow_thrust * cos(bow_angle)' and bow_y = "
        "'bow_thrust * sin(bow_angle)' under [channels] of the mapping file."
    )
    return about, _SHIP, _surface_craft(size, _small_hull(size), _RULES.block_of_two), hardware


def _surface_craft(
    size: MainDimensions, hull: list[EffectTable], low: float = _RULES.block[0]
) -> list[EffectTable]:
    """Tables of a surface craft: body, resistance and cross-flow, and what is its hull's own.

    `low`: least block coefficient that it may have.
    """
    if size.beam > size.length:
        raise UndertowError(
            f"beam = {size.beam:g} m exceeds length = {size.length:g} m: length is along, beam across it"
        )
    block, high = _block_coefficient(size), _RULES.block[1]
    if not low <= block <= high:
        raise UndertowError(
            f"mass = {size.mass:g} kg is a block coefficient of {block:.3g} (possible: {low:g} to {high:g}): "
            "correct the mass or a dimension; beam is overall (of two hulls: across both), height the draught"
        )
    inertia = _inertia(size)
    text = f"assumed: radius of gyration {_RULES.gyration:g} L (Fossen 2021)"
    body = [
        entry_line("m", size.mass, "kg", source="as stated"),
        entry_line("I_z", inertia, "kg m^2", sigma=_RULES.inertia * inertia, assumed=True, source=text),
    ]
    return [
        EffectTable("rigid_body", body),
        EffectTable("rigid_body_coriolis", []),
        *hull,
        EffectTable("added_mass_coriolis", []),
        EffectTable("quadratic_damping", [_resistance(size)]),
        EffectTable("crossflow_drag", list(_ship_crossflow(size))),
    ]


def _block_coefficient(size: MainDimensions) -> float:
    return size.displaced / (size.length * size.beam * size.height)


def _inertia(size: MainDimensions) -> float:
    return size.mass * (_RULES.gyration * size.length) ** 2


def _small_hull(size: MainDimensions) -> list[EffectTable]:
    across, about = _RULES.small_added[0] * size.mass, _RULES.small_added[1] * _inertia(size)
    time = _RULES.small_time * sqrt(size.length / 2)
    share, source = _RULES.small, "as for the Otter in MSS (Fossen)"
    added = [
        _surge_entry(size),
        _guess("Y_vdot", -across, "kg", share * across, f"1.5 m, {source}"),
        _guess("N_rdot", -about, "kg m^2", share * about, f"1.7 I_z, {source}"),
    ]
    text = f"time constant of {time:.2g} s, {source}, with the root of the length"
    sway, yaw = (size.mass + across) / time, (_inertia(size) + about) / time
    damping = [
        _guess("Y_v", -sway, "kg/s", share * sway, text),
        _guess("N_r", -yaw, "kg m^2/s", share * yaw, text),
    ]
    return [EffectTable("added_mass", added), EffectTable("linear_damping", damping)]


def _ship_hull(size: MainDimensions) -> list[EffectTable]:
    clarke, share = _clarke(size, _block_coefficient(size)), _RULES.regression
    added = {"Y_vdot": (clarke["Y_vdot"], "kg"), "N_rdot": (clarke["N_rdot"], "kg m^2")}
    coupling = {"Y_rdot": (clarke["Y_rdot"], "kg m")}
    return [
        EffectTable("added_mass", [_surge_entry(size), *_rows(added, share)]),
        EffectTable("added_mass_coupling", list(_rows(coupling, share))),
        EffectTable("lift", list(_ship_lift(size, clarke, share))),
    ]


def _clarke(size: MainDimensions, block: float) -> dict[str, float]:
    """Derivatives by the regression of Clarke, Gedling and Hine (1983), those of velocities per speed, SI."""
    length, draught = size.length, size.height
    slender, flat = size.beam / length, size.beam / draught
    scale = -pi * (draught / length) ** 2 * size.density / 2 * length**2
    # Clarke's Y_rdot and N_vdot, which an ideal fluid has equal, are regressions of their own: their mean.
    coupling = ((0.67 * slender - 0.0033 * flat**2) + (1.1 * slender - 0.041 * flat)) / 2
    return {
        "Y_vdot": scale * length * (1 + 0.16 * block * flat - 5.1 * slender**2),
        "Y_rdot": scale * length**2 * coupling,
        "N_rdot": scale * length**3 * (1 / 12 + 0.017 * block * flat - 0.33 * slender),
        "Y_v": scale * (1 + 0.40 * block * flat),
        "Y_r": scale * length * (-0.5 + 2.2 * slender - 0.080 * flat),
        "N_v": scale * length * (0.5 + 2.4 * draught / length),
        "N_r": scale * length**2 * (0.25 + 0.039 * flat - 0.56 * slender),
    }


_CLARKE = "regression of Clarke, Gedling and Hine (1983)"


def _surge_added_mass(size: MainDimensions) -> float:
    return 2.7 * size.density * size.displaced ** (5 / 3) / size.length**2


def _surge_entry(size: MainDimensions) -> str:
    ahead = _surge_added_mass(size)
    return _guess("X_udot", -ahead, "kg", 0.5 * ahead, "2.7 rho V^(5/3) / L^2 (Soeding 1982)")


def _rows(values: dict[str, tuple[float, str]], share: float) -> Iterator[str]:
    for name, (value, unit) in values.items():
        yield _guess(name, value, unit, share * abs(value), _CLARKE)


def _ship_lift(size: MainDimensions, clarke: dict[str, float], share: float) -> Iterator[str]:
    """What the regression leaves when the Coriolis terms of the added mass are taken off."""
    ahead = _surge_added_mass(size)
    munk = clarke["Y_vdot"] + ahead  # of the moment per u v that the added mass brings in
    text = f"{_CLARKE}, less the part in the added mass"
    yield from _rows({"Y_uv": (clarke["Y_v"], "kg/m")}, share)
    rest = {
        "N_uv": (clarke["N_v"] - munk, "kg", clarke["N_v"]),
        "Y_ur": (clarke["Y_r"] + ahead, "kg", ahead),
        "N_ur": (clarke["N_r"] - clarke["Y_rdot"], "kg m", clarke["N_r"]),
    }
    for name, (value, unit, scale) in rest.items():
        sigma = share * max(abs(scale), abs(value))
        yield _guess(name, value, unit, sigma, text)


def _resistance(size: MainDimensions) -> str:
    speed = _RULES.froude * sqrt(ENVIRONMENT.gravity * size.length)
    friction = 0.075 / (log10(speed * size.length / 1.19e-6) - 2) ** 2
    wetted = 1.7 * size.length * size.height + size.displaced / size.height
    value = size.density / 2 * wetted * friction * _RULES.resistance
    text = (
        f"friction of ITTC 1957 at Froude number {_RULES.froude:g} on {wetted:.3g} m^2 (Mumford), "
        f"times {_RULES.resistance:g} for form and waves"
    )
    sigma = _RULES.resistance_sigma * value
    return _guess("X_uabsu", -value, "kg/m", sigma, text)


def _ship_crossflow(size: MainDimensions) -> Iterator[str]:
    value = _RULES.crossflow * size.height
    text = f"draught times {_RULES.crossflow:g}, a section of a ship in cross-flow (Hoerner 1965)"
    sigma = _RULES.crossflow_sigma * value
    yield _guess("T_cross", value, "m", sigma, text)
    yield entry_line("L_cross", size.length, "m", source="as stated")
    yield entry_line("x_cross", 0.0, "m", source="the origin is midships")


TYPES: dict[str, Callable[[MainDimensions], Made]] = {
    "rov6": _rov6,
    "rov8": _rov8,
    "torpedo": _torpedo,
    "glider": _glider,
    "ship": _ship,
    "asv": _asv,
    "azimuth": _azimuth,
}
