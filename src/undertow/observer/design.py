"""An observer as a file states it: sensors with noise and rates, and what drives the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import casadi as ca
import numpy as np
from pydantic import Field

from undertow.codegen.manifest import whole_samples
from undertow.errors import UndertowError, refuse_unknown
from undertow.model.symbols import MOTION_UNITS
from undertow.model.tables import FileTable, Quantity, read_table
from undertow.model.units import to_si
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .filters import SETTINGS as FILTER
from .filters import (
    Method,
    Observer,
    Updated,
    added_noise,
    corrected,
    predicted,
    propagated_point,
    reported_point,
)
from .process import AT_REST, Kind, Process, process_of

SCHEMA = "undertow/observer/1"


@dataclass(frozen=True)
class DesignSettings:
    """Numbers of observers on board."""

    # Reports up to this age, s, count as of the present: at 1 m/s one of 20 ms is wrong by 2 cm, less than
    # most noise. Older ones have to be given to the filter at the time when they were true.
    late: float = 0.02
    # Time between reports, s, that come with every sample, where no sampling interval is at hand.
    sample: float = 0.01
    # Samples that a report in a loop is late at most: each sample does all of them again.
    max_past_steps: int = 500


SETTINGS = DesignSettings()


class SensorTable(FileTable):
    """A channel that is reported."""

    noise: Quantity  # standard deviation of a report
    period: Quantity = 0.0  # time between reports, s; zero: with every sample


class ObserverTable(FileTable):
    """The whole file."""

    schema_: Annotated[Literal["undertow/observer/1"], Field(alias="schema")]
    name: Annotated[str, Field(min_length=1, max_length=80)]
    description: str = ""
    process: Kind = "model"
    filter: Method = "ekf"
    estimate: list[str] = Field(default_factory=list)
    sensors: dict[str, SensorTable]
    # Root of the spectral density of the white noise on the rate of each driven state, SI times s^0.5.
    disturbance: dict[str, Annotated[float, Field(gt=0, allow_inf_nan=False)]]


class Numbers(NamedTuple):
    """What the functions of an observer take as given, as constants or as symbols."""

    vehicle: ca.SX
    densities: ca.SX
    variance: ca.SX
    gate: ca.SX


class ParametrisedFunctions(NamedTuple):
    """The functions of an observer by name, with its numbers p as an input, and the values of p by name.

    An extended filter has `predict` and one for each sensor, an unscented one what happens at one point.
    """

    functions: Mapping[str, ca.Function]
    values: Mapping[str, float]


def _function(name: str, given: Mapping[str, ca.SX], outputs: list[ca.SX], names: list[str]) -> ca.Function:
    """A function of what is given, without p where there is none."""
    own = {n: e for n, e in given.items() if n != "p" or e.numel()}
    return ca.Function(name, list(own.values()), outputs, list(own), names)


@dataclass(frozen=True, eq=False)
class Design:
    """An observer for one vehicle."""

    name: str
    process: Process
    channels: tuple[int, ...]  # channels of the process that are reported
    # variance, period: (k,): variance of a report and time between reports, s, of each of them
    variance: Array
    period: Array
    densities: Array  # spectral densities of the noise that drives the process
    lags: tuple[int, ...]  # (k,): samples that each report counts as late in a loop
    method: Method = "ekf"

    @property
    def late(self) -> dict[str, float]:
        """Ages of the reports that are no longer of the present, s, by sensor."""
        ages = zip(self.sensors, self.process.late[list(self.channels)].tolist(), strict=True)
        return {name: age for name, age in ages if age > SETTINGS.late}

    def sampled(self, dt: float) -> Design:
        """The observer in a loop of a sampling interval, s: its late reports are whole samples late."""
        lags = tuple(whole_samples(self.late.get(name, 0.0), dt) for name in self.sensors)
        if max(lags) > SETTINGS.max_past_steps:
            age = max(self.late.values())
            raise UndertowError(
                f"a report {age:g} s late is {max(lags)} samples of {dt:g} s late, and an observer in a loop "
                f"keeps {SETTINGS.max_past_steps}: lengthen dt to {age / SETTINGS.max_past_steps:.3g} s"
            )
        return replace(self, lags=lags)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the channels that are reported."""
        return tuple(self.process.channels[i] for i in self.channels)

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviation of a report by channel."""
        return dict(zip(self.sensors, np.sqrt(self.variance).tolist(), strict=True))

    # --- functions ----------------------------------------------------------------------------
    @cached_property
    def _numbers(self) -> Numbers:
        return Numbers(*map(ca.SX, (self.process.values, self.densities, self.variance, FILTER.gate)))

    @cached_property
    def predict(self) -> ca.Function:
        """`(x, P) = predict(x, P, u, t, dt)` with the parameters of the vehicle."""
        return self._prediction(self._numbers, ca.SX(0, 1))

    def _prediction(self, numbers: Numbers, p: ca.SX) -> ca.Function:
        x, P, u, t = self._symbols
        dt = ca.SX.sym("dt")
        given = x, P, u, numbers.vehicle, numbers.densities, t, dt
        new = predicted(self.process, *given, self.method)[:2]
        outputs = [ca.densify(o) for o in ca.cse(list(new))]
        return _function("predict", {"x": x, "P": P, "u": u, "p": p, "t": t, "dt": dt}, outputs, ["xn", "Pn"])

    def _updating(self, sensor: int, numbers: Numbers, p: ca.SX) -> ca.Function:
        """`(x, P, nis) = update(x, P, u, p, t, y)` with a report; nis beyond the gate was rejected."""
        x, P, u, t = self._symbols
        y = ca.SX.sym("y")
        got = self._updated(sensor, x, P, u, t, y, ca.SX(1), numbers)
        outputs = [ca.densify(o) for o in ca.cse([got.x, got.P, got.innovation**2 / got.variance])]
        given = {"x": x, "P": P, "u": u, "p": p, "t": t, "y": y}
        return _function("update", given, outputs, ["xn", "Pn", "nis"])

    def parametrised(self) -> ParametrisedFunctions:
        """The same with the numbers of vehicle and observer as an input p, noise as standard deviations.

        A design `with_names` has those of the hardware among them.
        """
        process = self.process
        noise, drive = (
            [ca.SX.sym(f"{what}_{name}") for name in names]
            for what, names in (("noise", self.sensors), ("disturbance", process.driven_names))
        )
        vehicle = [ca.SX.sym(e.name) for e in process.numbers]
        gate = ca.SX.sym("gate")
        numbers = Numbers(ca.vertcat(*vehicle), ca.vertcat(*drive) ** 2, ca.vertcat(*noise) ** 2, gate)
        roots = [*np.sqrt(self.variance), *np.sqrt(self.densities)]
        values = [*process.values.tolist(), *map(float, roots), FILTER.gate]
        symbols = [*vehicle, *noise, *drive, gate]
        p = ca.vertcat(*symbols)
        named = {e.name(): v for e, v in zip(symbols, values, strict=True)}
        ages = {"ages": self._ages(numbers, p)} if self.late else {}
        if self.method == "ukf":
            return ParametrisedFunctions(self._of_points(numbers, p) | ages, named)
        updates = {f"with_{name}": self._updating(k, numbers, p) for k, name in enumerate(self.sensors)}
        return ParametrisedFunctions({"predict": self._prediction(numbers, p)} | updates | ages, named)

    def with_names(self) -> Design:
        """The same for code that others use: see `Functions`."""
        own = self.process
        return replace(self, process=process_of(own.vehicle, own.estimated, own.kind, named=True))

    def _ages(self, numbers: Numbers, p: ca.SX) -> ca.Function:
        """`age = ages(p)`: how old the reports are, s, by sensor."""
        ages = ca.substitute(self.process.ages, self.process.p, numbers.vehicle)[list(self.channels)]
        return _function("ages", {"p": p}, [ca.densify(ages)], ["age"])

    def _of_points(self, numbers: Numbers, p: ca.SX) -> dict[str, ca.Function]:
        """What an unscented filter has besides its points: a motion, its noise, and the reports."""
        x, _, u, t = self._symbols
        dt, given = ca.SX.sym("dt"), {"x": x, "u": u, "p": p, "t": t}
        moved = propagated_point(self.process)(x, u, numbers.vehicle, t, dt)
        added = added_noise(self.process, x, u, numbers.vehicle, numbers.densities, t, dt)
        reports = {
            f"reported_{name}": _function(
                "reported", given, [reported_point(self.process, i)(x, u, numbers.vehicle, t)], ["z"]
            )
            for i, name in zip(self.channels, self.sensors, strict=True)
        }
        timed = given | {"dt": dt}
        return {
            "moved": _function("moved", timed, [moved], ["xn"]),
            "noise": _function("noise", timed, [ca.densify(ca.cse(added))], ["Pn"]),
        } | reports

    def _updated(
        self,
        sensor: int,
        x: ca.SX,
        P: ca.SX,
        u: ca.SX,
        t: ca.SX,
        y: ca.SX,
        there: ca.SX,
        numbers: Numbers | None = None,
    ) -> Updated:
        own, channel = numbers or self._numbers, self.channels[sensor]
        r = own.variance[sensor]
        given = x, P, u, own.vehicle, t, y, r, there, own.gate
        return corrected(self.process, channel, *given, self.method)

    @property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        n = self.process.x.numel()
        nu = self.process.u.numel()
        return ca.SX.sym("x", n), ca.SX.sym("P", n, n), ca.SX.sym("u", nu), ca.SX.sym("t")

    # --- in a loop ----------------------------------------------------------------------------
    # What a loop carries from sample to sample: z, which is state and upper half of its covariance, predicted
    # for the next sample; z before the reports of the oldest step that is kept, and the steps; the time since
    # each sensor's report. A step is commands, reports, which of these there are, and whether the loop had
    # begun. As in the C of an observer, a late report is used at the step when it was true, and what followed
    # is done again.
    @property
    def past_steps(self) -> int:
        """Steps of the past that are kept."""
        return max(self.lags, default=0)

    @property
    def z_size(self) -> int:
        """Entries of z."""
        n = self.process.x.numel()
        return n + n * (n + 1) // 2

    @property
    def step_size(self) -> int:
        """Entries of a step."""
        return self.process.u.numel() + 2 * len(self.channels) + 1

    @property
    def cuts(self) -> list[int]:
        """Where z, z of the oldest step, the steps and the times begin, and where all of it ends."""
        past = self.z_size if self.past_steps else 0, self.past_steps * self.step_size
        return [0, *accumulate((self.z_size, *past, len(self.channels)))]

    @property
    def size(self) -> int:
        """Entries of all that is carried."""
        return self.cuts[-1]

    def first(self, near: Mapping[str, float]) -> Array:
        """What a loop begins with: every sensor is about to report, `near` says what the state is near to."""
        mean = np.array([near.get(name, 0.0) for name in self.process.state_names])
        P = AT_REST.covariance(self.process)
        z = np.concatenate([mean, P[np.triu_indices(len(mean))]])
        past = [z, np.zeros(self.past_steps * self.step_size)] if self.past_steps else []
        return np.concatenate([z, *past, self.period])

    @cached_property
    def due(self) -> ca.Function:
        """`(there, agen) = due(age, dt)`: which sensors report, and the new times since their reports."""
        age, dt = ca.SX.sym("age", len(self.channels)), ca.SX.sym("dt")
        there = age >= self.period - dt / 2
        return ca.Function(
            "due", [age, dt], [there, age + dt - there * self.period], ["age", "dt"], ["there", "agen"]
        )

    @cached_property
    def replayed(self) -> ca.Function:
        """`zn = again(z, step, dt)`: a step of the past, its reports and then its commands."""
        z, step, dt = ca.SX.sym("z", self.z_size), ca.SX.sym("step", self.step_size), ca.SX.sym("dt")
        _, _, _, begun = self._parts_of(step)
        new = self.predicted_z(self.corrected(z, step), step, dt)
        kept = ca.densify(ca.cse(ca.if_else(begun, new, z)))
        return ca.Function("again", [z, step, dt], [kept], ["z", "step", "dt"], ["zn"])

    def corrected(self, z: ca.SX, step: ca.SX) -> ca.SX:
        """z after the reports of a step."""
        x, P = self._unpacked(z)
        _, y, there, _ = self._parts_of(step)
        zero = ca.SX.zeros(self.process.u.numel(), 1)
        for k in range(len(self.channels)):
            got = self._updated(k, x, P, zero, ca.SX(0), y[k], there[k])
            x, P = got.x, got.P
        return _packed(x, P)

    def predicted_z(self, z: ca.SX, step: ca.SX, dt: ca.SX) -> ca.SX:
        """z after the commands of a step."""
        return _packed(*self.predict(*self._unpacked(z), self._parts_of(step)[0], ca.SX(0), dt))

    def places(self, sensor: int) -> tuple[int, int]:
        """Places of a sensor's report, and of whether it is there, in a step."""
        u = self.process.u.numel()
        return u + sensor, u + len(self.channels) + sensor

    def _parts_of(self, step: ca.SX) -> list[ca.SX]:
        """Commands, reports, which there are, and whether the loop had begun."""
        u, m = self.process.u.numel(), len(self.channels)
        return ca.vertsplit(step, [0, u, u + m, u + 2 * m, u + 2 * m + 1])

    def _unpacked(self, z: ca.SX) -> tuple[ca.SX, ca.SX]:
        n = self.process.x.numel()
        half = ca.SX(n, n)
        for k, (i, j) in enumerate(zip(*np.triu_indices(n), strict=True)):
            half[int(i), int(j)] = z[n + k]
        return z[:n], ca.triu2symm(half)


def _packed(x: ca.SX, P: ca.SX) -> ca.SX:
    return ca.vertcat(x, *[P[int(i), int(j)] for i, j in zip(*np.triu_indices(x.numel()), strict=True)])


def load_observer(path: str | Path, vehicle: Vehicle) -> Design:
    """Read an observer file for a vehicle.

    Raises
    ------
    UndertowError
        If the file cannot be read, or names sensors or states that the vehicle does not have.
    """
    table = read_table(path, ObserverTable, "observer file")
    try:
        return design(table, vehicle)
    except UndertowError as error:
        raise UndertowError(f"{path}: {error}") from error


def design(table: ObserverTable, vehicle: Vehicle) -> Design:
    """The observer of a table for a vehicle."""
    process = process_of(vehicle, table.estimate, table.process)
    refuse_unknown(table.sensors, process.channels, "sensor ", " does not exist", "they are")
    refuse_unknown(table.disturbance, process.driven_names, "disturbance ", " does not exist", "they are")
    lacking = [n for n in process.driven_names if n not in table.disturbance]
    if lacking or not table.sensors:
        what = f"[disturbance] lacks {lacking[0]}" if lacking else "[sensors] is empty"
        raise UndertowError(f"{what}: undertow observe --save writes a file from a log")
    channels = [process.channels.index(n) for n in table.sensors]
    noise = [_positive(t.noise, MOTION_UNITS[n], f"noise of {n}") for n, t in table.sensors.items()]
    period = [_period(t.period, n) for n, t in table.sensors.items()]
    densities = np.array([table.disturbance[n] for n in process.driven_names]) ** 2
    Observer(process, densities)
    return Design(
        table.name,
        process,
        tuple(channels),
        np.array(noise) ** 2,
        np.array(period, dtype=float),
        densities,
        (0,) * len(channels),
        table.filter,
    )


def _positive(value: Quantity, unit: str, what: str) -> float:
    found = to_si(value, unit)
    if not 0 < found < np.inf:
        raise UndertowError(f"{what} = {found:g} {unit}: give a standard deviation above zero")
    return found


def _period(value: Quantity, sensor: str) -> float:
    found = to_si(value, "s")
    if found < 0:
        raise UndertowError(
            f"period of {sensor} = {found:g} s: give the time between reports, 0 for all samples"
        )
    return found
