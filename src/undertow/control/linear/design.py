"""Gains by quadratic design: LQR for the laws of gain files, and LQG with an observer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import control as ct
import numpy as np
import tomlkit

from undertow.codegen.functions import Functions
from undertow.control.gains import GainSet, GainTable, gains_from_table
from undertow.control.laws import LAWS
from undertow.control.plant import remedy_for_curves
from undertow.errors import UndertowError, of_stated_kinds, refuse_unknown
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .analysis import Mode, controllability, modes, observability
from .numeric import as_input_error, with_ideal_thrust
from .systems import LinearLoop, close_loop, forces_of, linearize, named, with_forces
from .trim import Trim, find_trim

DESIGNED = ("pd", "pid")
_HORIZONTAL = ("x", "y")


@dataclass(frozen=True)
class DesignSettings:
    """The numbers of a quadratic design."""

    # Time, s, over which an integral is to remove an error, beside the time constant of the loop without.
    integral_time: float = 5.0
    integral_time_factor: float = 2.0  # factor on this time as often as the conditions on gains fail
    rounds: int = 12  # most trials
    # Riccati equations lose their digits far beyond what these acceptable errors and forces, SI, span.
    weights: tuple[float, float] = (1e-9, 1e9)
    decays: float = -1e-9  # real part, 1/s, above which a state left to itself does not come to rest


SETTINGS = DesignSettings()

Verdict = Callable[[GainSet], bool]


@dataclass(frozen=True)
class Design:
    """Gains from a quadratic design."""

    gains: GainSet
    loop: LinearLoop  # that they close
    coupling: float  # largest part of the full optimal gain that the diagonal law leaves out, as a share
    slowed: int  # how often the integral was given more time until the conditions held
    certified: bool | None  # what the conditions say; None where there are none

    @property
    def modes(self) -> list[Mode]:
        """Poles of the closed loop."""
        return modes(self.loop.closed)

    @property
    def coordinates(self) -> list[str]:
        """Coordinates that have gains."""
        gain = type(self.gains.law).gains[0]
        return [c for c in self.gains.signals.coordinates if self.gains.values[str(gain.symbol(c))]]

    def to_toml(self, source: str) -> str:
        """Text of a gain file; `source` says in it where the gains are from."""
        gains, rows = self.gains, {}
        for gain in type(gains.law).gains:
            rows[gain.name] = tomlkit.inline_table()
            for c in self.coordinates:
                rows[gain.name][c] = f"{gains.values[str(gain.symbol(c))]:.6g} {gain.unit(c)}"
        content = {
            "schema": "undertow/gains/1",
            "name": gains.name,
            "description": f"{gains.law.id} for {gains.plant.vehicle.name}",
            "source": source,
            "law": gains.law.id,
            **({"unactuated": list(gains.unactuated)} if gains.unactuated else {}),
            "gains": rows,
        }
        heading = "# Linear-quadratic design at hover with the diagonal of the optimal gain.\n"
        return heading + tomlkit.dumps(content)


@of_stated_kinds
def lqr(
    vehicle: Vehicle,
    error: Mapping[str, float],
    force: Mapping[str, float],
    *,
    law: str = "pd",
    trim: Trim | None = None,
    conditions: Verdict | None = None,
    name: str = "lqr",
) -> Design:
    """A gain set by linear-quadratic design at hover.

    The weights are Bryson's: an error as large as `error` counts as much as a force as large as `force`. The
    law of a gain file is diagonal, so of the full optimal gain the diagonal is taken, in x and y the larger
    one for both. Thrust is taken as ideal in the design; the resulting loop is checked with thruster lag and
    the like. If conditions are given and fail, the integral is slowed down until they hold.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    error : mapping
        Acceptable error by pose coordinate (x, y, z, phi, theta, psi), m and rad: of each that is actuated.
    force : mapping
        Available force by degree of freedom (surge ...), N and N m: of each that is actuated.
    law : str
        "pd" or "pid".
    trim : Trim, optional
        Where the loop is linear; hover in still water unless stated.
    conditions : callable, optional
        Says whether a gain set satisfies the conditions that certify it.
    name : str
        Of the gain set.

    Raises
    ------
    UndertowError
        If a weight is missing or not positive, the law is no such law, or the diagonal law does not hold the
        vehicle, or no integral is slow enough for the conditions.
    """
    if law not in DESIGNED:
        raise UndertowError(f"law '{law}' has no quadratic design: use {' or '.join(DESIGNED)}")
    found = trim or find_trim(vehicle)
    channels = _Channels(vehicle, found, error, force)
    for slowed in range(SETTINGS.rounds):
        integral_time = SETTINGS.integral_time * SETTINGS.integral_time_factor**slowed
        gains, coupling = channels.gains(law, integral_time, name)
        certified = None if conditions is None else conditions(gains)
        if certified is not False or law == "pd":
            break
    else:
        raise UndertowError(
            f"no '{law}' design with these errors and forces meets the conditions: allow more force or "
            "more error"
        )
    loop = close_loop(vehicle, gains, found)
    growing = [m for m in modes(loop.closed) if not m.stable]
    if growing:
        raise UndertowError(
            f"the diagonal law does not hold the vehicle: a mode in {', '.join(growing[0].states)} grows "
            f"with {growing[0].pole.real:.3g} 1/s; its motions are too strongly coupled for one gain each"
        )
    return Design(gains, loop, coupling, slowed, certified)


class _Channels:
    """The actuated coordinates of a vehicle at a trim, for design."""

    def __init__(
        self, vehicle: Vehicle, trim: Trim, error: Mapping[str, float], force: Mapping[str, float]
    ) -> None:
        self.vehicle, self.trim = vehicle, trim
        # The linear vehicle with ideal thrust: the law feeds no lag back, and a dead band has no slope.
        ideal = with_ideal_thrust(vehicle)
        names = Functions(ideal).state_names
        plant = with_forces(
            linearize(ideal, replace(trim, states={n: trim.states[n] for n in names})), forces_of(vehicle)
        )
        actuated = [name.removeprefix("force_") for name in plant.input_labels]
        if not actuated:
            remedy = remedy_for_curves(vehicle) or f"'{vehicle.name}' has no thruster: add one"
            raise UndertowError(f"there is nothing to design: {remedy}")
        self.rows = [i for i, d in enumerate(vehicle.degrees_of_freedom) if d in actuated]
        self.coordinates = [vehicle.pose_names[i] for i in self.rows]
        dofs = [vehicle.degrees_of_freedom[i] for i in self.rows]
        self._error = _positive("error", error, self.coordinates)
        self._force = _positive("force", force, dofs)
        velocities = [vehicle.velocity_names[i] for i in self.rows]
        kept = [plant.state_labels.index(n) for n in (*self.coordinates, *velocities)]
        self._a, self._b = plant.A[np.ix_(kept, kept)], plant.B[kept]

    def gains(self, law: str, integral_time: float, name: str) -> tuple[GainSet, float]:
        """The diagonal of the optimal gain as a gain set, and the neglected share."""
        optimal = self._optimal(1 / integral_time if law == "pid" else None)
        n = len(self.rows)
        parts = [optimal[:, i * n : (i + 1) * n] for i in range(optimal.shape[1] // n)]
        largest = max(_coupling(part) for part in parts)
        names = [g.name for g in LAWS[law].gains]
        values = {gain: self._equal_in_plane(np.diag(part)) for gain, part in zip(names, parts, strict=True)}
        return self._as_gains(law, values, name), largest

    def _equal_in_plane(self, diagonal: Array) -> dict[str, float]:
        """A gain by coordinate, the same in x and y: they are axes of the earth, and the vehicle turns."""
        values = dict(zip(self.coordinates, map(float, diagonal), strict=True))
        actuated = [values[c] for c in _HORIZONTAL if c in values]
        level = [c for c in self.vehicle.pose_names if c in _HORIZONTAL and actuated]
        return values | dict.fromkeys(level, max(actuated, default=0.0))

    def _optimal(self, rate: float | None) -> Array:
        """The full optimal gain in errors, velocities and, with a rate in 1/s, integrals of the errors."""
        n = len(self.rows)
        a, b, cost = self._a, self._b, np.r_[1 / self._error**2, np.zeros(n)]
        if rate is not None:
            a = np.block([[a, np.zeros((2 * n, n))], [np.eye(n), np.zeros((n, 2 * n))]])
            b = np.vstack([b, np.zeros((n, n))])
            cost = np.r_[cost, (rate / self._error) ** 2]
        remedy = "give errors and forces of more similar size"
        with as_input_error("no design with these errors and forces", remedy, ValueError):
            gain, _, _ = ct.lqr(a, b, np.diag(cost), np.diag(1 / self._force**2))
        return np.asarray(gain, dtype=float)

    def _as_gains(self, law: str, values: Mapping[str, Mapping[str, float]], name: str) -> GainSet:
        gains = {
            gain.name: {c: f"{value:.6g} {gain.unit(c)}" for c, value in values[gain.name].items()}
            for gain in LAWS[law].gains
        }
        unactuated = [d for i, d in enumerate(self.vehicle.degrees_of_freedom) if i not in self.rows]
        content = {"schema": "undertow/gains/1", "name": name, "law": law, "gains": gains}
        return gains_from_table(GainTable.model_validate(content | {"unactuated": unactuated}), self.vehicle)


def _coupling(part: Array) -> float:
    scale = np.sqrt(np.abs(np.outer(np.diag(part), np.diag(part))))
    return float(np.max(np.abs(part - np.diag(np.diag(part))) / scale, initial=0.0))


def _positive(what: str, given: Mapping[str, float], names: list[str]) -> Array:
    unknown = [n for n in given if n not in names]
    if unknown:
        raise UndertowError(f"{what} of {unknown[0]} has no effect: commands push in {', '.join(names)}")
    for name in names:
        value = given.get(name)
        if value is None or not 0 < value < np.inf:
            shown = "missing" if value is None else f"{value:g}"
            raise UndertowError(f"{what} of {name} is {shown}: give a positive one for {', '.join(names)}")
        least, most = SETTINGS.weights
        if not least <= value <= most:
            raise UndertowError(f"{what} of {name} is {value:g}: give one from {least:g} to {most:g} (SI)")
    return np.array([float(given[n]) for n in names])


# --- LQG ----------------------------------------------------------------------------------------
@of_stated_kinds
def lqg(
    vehicle: Vehicle,
    trim: Trim | Mapping[str, float],
    weights: Mapping[str, float],
    force: Mapping[str, float],
    disturbance: Mapping[str, float],
    noise: Mapping[str, float],
) -> ct.StateSpace:
    """An observer and an optimal feedback in one: from reports of the sensors in `noise` to commands.

    Uncontrollable states are left to themselves, and unobservable ones are left out.

    Parameters
    ----------
    vehicle, trim
        As for `linearize`.
    weights : mapping
        Acceptable deviation by state, SI; states that are not named are not weighted.
    force : mapping
        Available command by name, in units of the command.
    disturbance : mapping
        Strength of white noise by state, in units of the state per square root of a second.
    noise : mapping
        Strength of the noise of a sensor by output, in its unit times square root of a second. These are the
        inputs of the result.

    Raises
    ------
    UndertowError
        If a name is unknown, a value is not positive, or a state that grows or stays cannot be moved or seen.
    """
    plant = linearize(vehicle, trim)
    states = plant.state_labels
    for what, given in (("weight", weights), ("disturbance", disturbance)):
        refuse_unknown(given, states, f"{what} of ", ", which is not a state", "give")
        _positive(what, given, list(given))
    shown = ct.ss(plant.A, plant.B, plant.C[[_output_index(plant.output_labels, n) for n in noise]], 0)
    kept = _minimal_states(plant, shown)
    a, b, c = plant.A[np.ix_(kept, kept)], plant.B[kept], shown.C[:, kept]
    names = [plant.state_labels[i] for i in kept]
    q = np.diag([1 / weights[n] ** 2 if n in weights else 0.0 for n in names])
    r = np.diag(1 / _positive("command", force, plant.input_labels) ** 2)
    v = np.diag([disturbance.get(n, 0.0) ** 2 for n in names])
    w = np.diag(_positive("noise", noise, list(noise)) ** 2)
    with as_input_error("no LQG design", "give weights and disturbances to more states", ValueError):
        gain = np.asarray(ct.lqr(a, b, q, r)[0])
        observer = np.asarray(ct.lqe(a, np.eye(len(kept)), c, v, w)[0])
    system = ct.ss(a - b @ gain - observer @ c, observer, -gain, np.zeros((len(r), len(w))))
    return named(system, [f"{n}_hat" for n in names], list(noise), plant.input_labels, "lqg")


def _output_index(labels: list[str], name: str) -> int:
    if name not in labels:
        raise UndertowError(f"'{name}' is not an output of the linear system: it has {', '.join(labels)}")
    return labels.index(name)


def _minimal_states(plant: ct.StateSpace, shown: ct.StateSpace) -> list[int]:
    """Controllable and observable states; all others must be stable."""
    named_shown = named(
        shown, plant.state_labels, plant.input_labels, [str(i) for i in range(shown.noutputs)], ""
    )
    lost = {*controllability(plant).missing, *observability(named_shown).missing}
    removed = [i for i, n in enumerate(plant.state_labels) if n in lost]
    poles = np.linalg.eigvals(plant.A[np.ix_(removed, removed)]) if removed else np.empty(0)
    if np.any(poles.real > SETTINGS.decays):
        names = ", ".join(plant.state_labels[i] for i in removed)
        raise UndertowError(
            f"no LQG design: {names} are not controllable or not observable, and not stable by themselves: "
            "use another trim or more sensors"
        )
    return [i for i in range(plant.nstates) if i not in removed]
