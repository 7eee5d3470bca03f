"""A hull at the surface: added mass, radiation damping and wave forces at every frequency, by panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from undertow.errors import UndertowError
from undertow.model.symbols import ENVIRONMENT
from undertow.typing import Array, Progress

from .bodies import AddedMass
from .mesh import Mesh, load_capytaine
from .panels import UP, panels, radiated, solved

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class FloatingRules:
    """How a hull at the surface is computed."""

    panels: int = 1600  # of the whole hull; half of them or so are under water
    frequencies: int = 24
    longest: float = 60.0  # longest wave over the length of the hull in the water
    shortest: float = 0.4  # shortest wave over its beam; beyond it hulls radiate next to nothing
    level: float = 1e-6  # share of the height to which the waterline is known
    thin: float = 0.01  # share of the height that has to be under water, and out of it
    cells: float = 3.0  # panels along the shortest wave, at least
    headings: int = 9  # of a regular wave, from astern to ahead on one side
    theta: int = 181  # directions of the waves that go out, for the drift
    beyond: float = 0.1  # rad by which they reach beyond a turn


FLOATING_RULES = FloatingRules()
_SIGNS = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # of forces, between body axes and those with z up


@dataclass(frozen=True)
class FloatingHull:
    """A hull that floats, about an origin in the waterline above its centre of volume; body axes.

    `at_infinity` is the added mass at infinite frequency; `added` and `damping`, shape (n, 6, 6), are those
    at the frequencies `omega`, (n,), rad/s.
    """

    origin: Array  # (3,): in the coordinates of the mesh, m
    draught: float  # m
    length: float  # of the waterline, m
    stiffness: Array  # (6, 6): weight and buoyancy, N/m and so on, positive as it rights
    at_infinity: AddedMass
    omega: Array
    added: Array
    damping: Array
    panels: int  # under water

    def kernel(self, i: int) -> Complex:
        """What the memory of a motion adds to its force per velocity at each frequency, shape (n,)."""
        beyond = self.added[:, i, i] - self.at_infinity.matrix[i, i]
        return np.asarray(self.damping[:, i, i] + 1j * self.omega * beyond)


@dataclass(frozen=True)
class RegularWave:
    """What a regular wave of unit amplitude does to a hull, from all headings of one side.

    `headings` (h,) is the angle from the bow to where the wave travels, rad. Forces (h, 6) are complex: their
    real part goes with the elevation at the origin, the imaginary part a quarter period behind.
    """

    omega: float
    headings: Array
    excitation: Complex  # (h, 6): on the hull held fast, N/m and N m/m
    motion: Complex  # (h, 6): of the hull that floats freely, m/m and rad/m
    drift: Array  # (h, 3): mean force ahead and to starboard, and yaw moment, N/m^2 and N m/m^2


def waterline(hull: Mesh, volume: float) -> tuple[Array, float]:
    """Origin in the waterline above the centre of the immersed volume, (3,), and draught, m.

    `volume`: what has to be under water, m^3.
    """
    cpt = load_capytaine()
    low, high = hull.bounds[:, 2]
    if not 0 < volume < hull.volume:
        raise UndertowError(
            f"the hull would have to displace {volume:.4g} m^3 and encloses {hull.volume:.4g} m^3: it sinks; "
            "correct the mass, the density or the unit of the mesh"
        )

    def missing(level: float) -> float:
        return float(_immersed(cpt, hull, np.array([0.0, 0.0, level])).disp_volume) - volume

    least, most = low + FLOATING_RULES.thin * (high - low), high - FLOATING_RULES.thin * (high - low)
    if missing(most) > 0 or missing(least) < 0:
        raise UndertowError(
            f"{volume:.4g} m^3 leave less than {FLOATING_RULES.thin:.0%} of the height of the hull in or out "
            "of the water: correct the mass, the density or the unit of the mesh"
        )
    level = float(brentq(missing, least, most, xtol=FLOATING_RULES.level * (high - low)))
    centre = _immersed(cpt, hull, np.array([0.0, 0.0, level])).center_of_buoyancy
    return np.array([centre[0], -centre[1], level]), float(high - level)


def _immersed(cpt: Any, hull: Mesh, origin: Array) -> Any:
    """The part of a hull under the surface, z up, about an origin in the waterline."""
    return cpt.Mesh((hull.vertices - origin) @ UP, hull.faces).immersed_part()


def _stiffness(wet: Any, mass: float, cg: float, density: float) -> Array:
    """Restoring matrix about the origin, body axes, (6, 6), of the immersed part of a hull, z up."""
    corners = wet.vertices[wet.faces]
    corners = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]) @ UP
    a, b, c = (corners[:, i] for i in range(3))
    # The waterplane is what the hull covers of it; z is down, and so is what the hull shows below.
    shade = np.cross(b - a, c - a)[:, 2] / 2
    x, y = corners[:, :, 0], corners[:, :, 1]

    def moment(p: Array, q: Array) -> float:
        return float(shade @ (p.sum(axis=1) * q.sum(axis=1) + (p * q).sum(axis=1)) / 12)

    area, ahead, aside = float(shade.sum()), shade @ x.mean(axis=1), shade @ y.mean(axis=1)
    found = np.zeros((6, 6))
    found[2:5, 2:5] = density * ENVIRONMENT.gravity * np.array(
        [[area, aside, -ahead], [aside, moment(y, y), -moment(x, y)], [-ahead, -moment(x, y), moment(x, x)]]
    )  # fmt: skip
    arm = mass * ENVIRONMENT.gravity * (cg + float(wet.center_of_buoyancy[2]))
    found[3, 3] += arm
    found[4, 4] += arm
    return found


class FloatingBody:
    """A hull that floats, ready to be solved; `mass` kg, `cg` its place under (+) the waterline, m."""

    def __init__(
        self, hull: Mesh, mass: float, cg: float, density: float, finest: int = FLOATING_RULES.panels
    ) -> None:
        self._cpt = load_capytaine()
        self.density, self.mass = density, mass
        self.origin, self.draught = waterline(hull, mass / density)
        _, coarse, fine = panels(hull, finest)
        self._coarse, self._fine = (_immersed(self._cpt, m, self.origin) for m in (coarse, fine))
        self.panels = int(self._fine.nb_faces)  # under water
        self.omega = self._frequencies()
        self._lid = self._fine.generate_lid(z=self._fine.lowest_lid_position(omega_max=self.omega[-1]))
        self._body = self._of(self._fine, (0.0, 0.0, -cg), self._lid)
        self.stiffness = _stiffness(_immersed(self._cpt, hull, self.origin), mass, cg, density)
        self._check_upright()

    def _of(self, mesh: Any, cg: tuple[float, float, float], lid: Any = None) -> Any:
        cpt = self._cpt
        return cpt.FloatingBody(
            mesh,
            cpt.rigid_body_dofs(rotation_center=(0, 0, 0)),
            lid_mesh=lid,
            center_of_mass=cg,
            mass=self.mass,
            name="hull",
        )

    def _frequencies(self) -> Array:
        """From waves much longer than the hull to such as are shorter than its beam, if panels show them."""
        (length, beam, _), rules = np.ptp(self._fine.vertices, axis=0), FLOATING_RULES
        panel = float(np.sqrt(self._fine.faces_areas.mean()))
        ends = np.array([rules.longest * length, max(rules.shortest * beam, rules.cells * panel)])
        low, high = np.sqrt(2 * np.pi * ENVIRONMENT.gravity / ends)
        return np.geomspace(low, high, rules.frequencies)

    def _check_upright(self) -> None:
        roll, pitch = self.stiffness[3, 3], self.stiffness[4, 4]
        if min(roll, pitch) <= 0:
            gm = min(roll, pitch) / (self.mass * ENVIRONMENT.gravity)
            raise UndertowError(
                f"metacentric height = {gm:.3g} m: the hull does not float upright; lower the centre of "
                "gravity with --cg 0,0,Z (below the waterline)"
            )

    def radiation(self, report: Progress = lambda done, words: None) -> FloatingHull:
        """Added mass and radiation damping at all frequencies and at an infinite one."""
        report(0.0, "panels, and a table of waves (made once)")
        coarse = self._radiated(self._of(self._coarse, (0.0, 0.0, 0.0)), np.inf).real
        fine = self._radiated(self._of(self._fine, (0.0, 0.0, 0.0)), np.inf).real
        found = []
        for k, omega in enumerate(self.omega):
            report(k / len(self.omega), f"{omega:.3g} rad/s, {self.panels} panels")
            found.append(self.at(float(omega)))
        source = (
            f"capytaine {self._cpt.__version__}, direct method; {self.panels} panels under water, "
            "infinite frequency"
        )
        limits = "ideal fluid, small motions in a calm sea, no speed ahead"
        at_infinity = AddedMass(fine, source, limits, np.abs(fine - coarse))
        together = np.array(found)
        return FloatingHull(
            self.origin,
            self.draught,
            float(np.ptp(self._fine.vertices[:, 0])),
            self.stiffness,
            at_infinity,
            self.omega,
            together.real,
            together.imag,
            self.panels,
        )

    def at(self, omega: float) -> Complex:
        """Added mass + i radiation damping at a frequency, rad/s, about the origin, body axes, (6, 6)."""
        return self._radiated(self._body, omega)

    def _radiated(self, body: Any, omega: float) -> Complex:
        """Added mass + i radiation damping about the origin, body axes, shape (6, 6), symmetric."""
        found = radiated(solved(self._cpt, self._radiation_problems(body, omega), omega))
        return (found + found.T) / 2

    def _radiation_problems(self, body: Any, omega: float) -> list[Any]:
        given = self._at_surface(body, omega)
        return [self._cpt.RadiationProblem(radiating_dof=d, **given) for d in body.dofs]

    def _at_surface(self, body: Any, omega: float) -> dict[str, Any]:
        """What every problem at a frequency is given."""
        water = {"rho": self.density, "g": ENVIRONMENT.gravity, "free_surface": 0.0}
        return {"body": body, "omega": omega, **water}

    # --- a regular wave ---------------------------------------------------------------------------
    def regular_wave(self, omega: float, inertia: Array) -> RegularWave:
        """What a regular wave does; `inertia`: mass matrix about the origin, body axes, (6, 6)."""
        low, high = self.omega[0], self.omega[-1]
        if not low <= omega <= high:
            raise UndertowError(
                f"wave of {omega:.4g} rad/s is out of reach of these panels: choose {low:.3g} to {high:.3g}"
            )
        headings = np.linspace(0.0, np.pi, FLOATING_RULES.headings)
        # With z up a wave that travels to starboard travels to minus y.
        given = self._at_surface(self._body, omega)
        problems = [self._cpt.DiffractionProblem(wave_direction=-h, **given) for h in headings]
        scattered = solved(self._cpt, problems, omega)
        pressed = self._cpt.bem.airy_waves.froude_krylov_force
        dofs = list(self._body.dofs)
        forces = np.array(
            [[r.forces[d] + pressed(p)[d] for d in dofs] for p, r in zip(problems, scattered, strict=True)]
        )
        radiated = self.at(omega)
        excitation = forces * _SIGNS
        system = -(omega**2) * (inertia + radiated.real) - 1j * omega * radiated.imag + self.stiffness
        motion = np.linalg.solve(system, excitation.T).T
        return RegularWave(omega, headings, excitation, motion, self._drift(omega, problems, motion * _SIGNS))

    def _drift(self, omega: float, problems: Sequence[Any], motion: Complex) -> Array:
        """Mean force by the momentum of the waves that go out, shape (h, 3); `motion` with z up.

        By Capytaine's far-field drift, one direction at a time.
        """
        import xarray as xr

        kochin = self._cpt.post_pro.compute_kochin
        margin = FLOATING_RULES.beyond
        count = FLOATING_RULES.theta
        theta = np.linspace(-np.pi - margin, 2 * np.pi + margin, count + count // 2)
        radiating = solved(self._cpt, self._radiation_problems(self._body, omega), omega, "indirect")
        scattering = solved(self._cpt, problems, omega, "indirect")
        radiated = np.array([kochin(r, theta) for r in radiating])
        scattered = np.array([kochin(r, theta) for r in scattering])
        dofs = list(self._body.dofs)
        rows = []
        for k, direction in enumerate(p.wave_direction for p in problems):
            head = {"omega": [omega], "wave_direction": [direction], "theta": theta, "radiating_dof": dofs}
            data = xr.Dataset(
                {
                    "kochin_diffraction": (("omega", "wave_direction", "theta"), scattered[None, k : k + 1]),
                    "kochin_radiation": (("omega", "radiating_dof", "theta"), radiated[None]),
                },
                head
                | {
                    "wavenumber": omega**2 / ENVIRONMENT.gravity,
                    "water_depth": np.inf,
                    "rho": self.density,
                    "g": ENVIRONMENT.gravity,
                },
            )
            X = xr.DataArray(
                motion[None, k : k + 1],
                {n: head[n] for n in ("omega", "wave_direction", "radiating_dof")},
                ("omega", "wave_direction", "radiating_dof"),
            )
            found = self._cpt.post_pro.far_field_mean_drift_force(X, data)
            rows.append(
                [float(found[f"drift_force_{n}"].values.real.squeeze()) for n in ("surge", "sway", "yaw")]
            )
        return np.array(rows) * _SIGNS[[0, 1, 5]]
