"""An observer as a file states it: sensors with noise and rates, and what drives the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import casadi as ca
import numpy as np
from pydantic import Field, ValidationError

from undertow.errors import UndertowError, nearest
from undertow.files import read_toml
from undertow.model.symbols import MOTION_UNITS
from undertow.model.tables import FileTable, Quantity
from undertow.model.units import to_si
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .filters import SETTINGS as FILTER
from .filters import Believed, Observer, corrected, predicted
from .process import AT_REST, Kind, Process, process_of

SCHEMA = "undertow/observer/1"


@dataclass(frozen=True)
class DesignSettings:
    """Numbers of observers on board."""

    # Reports older than this, s, are refused: at 1 m/s one of 20 ms is wrong by 2 cm, less than most noise.
    # Older ones have to be given to the filter at the time when they were true.
    late: float = 0.02
    # Time between reports, s, that come with every sample, where no sampling interval is at hand.
    sample: float = 0.01


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
    estimate: list[str] = Field(default_factory=list)
    sensors: dict[str, SensorTable]
    # Root of the spectral density of the white noise on the rate of each driven state, SI times s^0.5.
    disturbance: dict[str, Annotated[float, Field(gt=0)]]


@dataclass(frozen=True, eq=False)
class Design:
    """An observer for one vehicle.

    Attributes
    ----------
    name : str
    process : Process
    channels : tuple of int
        Channels of the process that are reported.
    variance, period : ndarray, shape (k,)
        Variance of a report and time between reports, s, of each of them.
    densities : ndarray
        Spectral densities of the noise that drives the process.
    """

    name: str
    process: Process
    channels: tuple[int, ...]
    variance: Array
    period: Array
    densities: Array

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
    def predict(self) -> ca.Function:
        """`(x, P) = predict(x, P, u, t, dt)` with the parameters of the vehicle."""
        x, P, u, t = self._symbols
        dt = ca.SX.sym("dt")
        f = self.process
        new = predicted(f, x, P, u, ca.SX(f.values), ca.SX(self.densities), t, dt)[:2]
        outputs = ca.cse([ca.densify(o) for o in new])
        return ca.Function("predict", [x, P, u, t, dt], outputs, ["x", "P", "u", "t", "dt"], ["xn", "Pn"])

    def update(self, sensor: int) -> ca.Function:
        """`(x, P, nis) = update(x, P, u, t, y)` with a report; nis beyond the gate was not believed."""
        x, P, u, t = self._symbols
        y = ca.SX.sym("y")
        got = self._believed(sensor, x, P, u, t, y, ca.SX(1))
        outputs = [ca.densify(o) for o in (got.x, got.P, got.innovation**2 / got.variance)]
        names = ["x", "P", "u", "t", "y"], ["xn", "Pn", "nis"]
        return ca.Function("update", [x, P, u, t, y], ca.cse(outputs), *names)

    def _believed(
        self, sensor: int, x: ca.SX, P: ca.SX, u: ca.SX, t: ca.SX, y: ca.SX, there: ca.SX
    ) -> Believed:
        f, channel, r = self.process, self.channels[sensor], ca.SX(float(self.variance[sensor]))
        return corrected(f, channel, x, P, u, ca.SX(f.values), t, y, r, there, ca.SX(FILTER.gate))

    @property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        n = self.process.x.numel()
        nu = self.process.u.numel()
        return ca.SX.sym("x", n), ca.SX.sym("P", n, n), ca.SX.sym("u", nu), ca.SX.sym("t")

    # --- in a loop ----------------------------------------------------------------------------
    @property
    def size(self) -> int:
        """Entries of `packed`: state, upper half of its covariance, time since each sensor's report."""
        n = self.process.x.numel()
        return n + n * (n + 1) // 2 + len(self.channels)

    def first(self, near: Mapping[str, float]) -> Array:
        """What a loop begins with: every sensor is about to report, `near` says what the state is near to."""
        mean = np.array([near.get(name, 0.0) for name in self.process.state_names])
        P = AT_REST.covariance(self.process)
        return np.concatenate([mean, P[np.triu_indices(len(mean))], self.period])

    def unpacked(self, packed: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """State, covariance and ages."""
        n = self.process.x.numel()
        half = ca.SX(n, n)
        for k, (i, j) in enumerate(zip(*np.triu_indices(n), strict=True)):
            half[int(i), int(j)] = packed[n + k]
        return packed[:n], ca.triu2symm(half), packed[self.size - len(self.channels) :]

    def seen(self, packed: ca.SX, y: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """State and covariance after those of the reports y (by sensor) that are due, and the new ages."""
        x, P, age = self.unpacked(packed)
        zero = ca.SX.zeros(self.process.u.numel(), 1)
        ages = []
        for k in range(len(self.channels)):
            due = age[k] >= float(self.period[k]) - dt / 2
            got = self._believed(k, x, P, zero, ca.SX(0), y[k], due)
            x, P = got.x, got.P
            ages.append(age[k] + dt - due * float(self.period[k]))
        return x, P, ca.vertcat(*ages)

    def ahead(self, x: ca.SX, P: ca.SX, age: ca.SX, u: ca.SX, dt: ca.SX) -> ca.SX:
        """What is carried to the next sample."""
        x, P = self.predict(x, P, u, ca.SX(0), dt)
        n = x.numel()
        half = [P[int(i), int(j)] for i, j in zip(*np.triu_indices(n), strict=True)]
        return ca.vertcat(x, *half, age)


def load_observer(path: str | Path, vehicle: Vehicle) -> Design:
    """Read an observer file for a vehicle.

    Raises
    ------
    UndertowError
        If the file cannot be read, or names sensors or states that the vehicle does not have.
    """
    try:
        table = ObserverTable.model_validate(read_toml(path, "observer file"))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise UndertowError(f"{path}: {where}: {first['msg'].lower()}: see docs/observer.md") from error
    try:
        return design(table, vehicle)
    except UndertowError as error:
        raise UndertowError(f"{path}: {error}") from error


def design(table: ObserverTable, vehicle: Vehicle) -> Design:
    """The observer of a table for a vehicle."""
    process = process_of(vehicle, table.estimate, table.process)
    _refuse_alien("sensor", table.sensors, process.channels)
    _refuse_alien("disturbance", table.disturbance, process.driven_names)
    lacking = [n for n in process.driven_names if n not in table.disturbance]
    if lacking or not table.sensors:
        what = f"[disturbance] lacks {lacking[0]}" if lacking else "[sensors] is empty"
        raise UndertowError(f"{what}: undertow observe --save writes a file from a log")
    channels = [process.channels.index(n) for n in table.sensors]
    late = [(n, process.late[i]) for n, i in zip(table.sensors, channels, strict=True)]
    for name, age in late:
        if age > SETTINGS.late:
            raise UndertowError(
                f"{name} is reported {age:g} s late, and an observer on board takes {SETTINGS.late:g} s: "
                "leave the delay out of the vehicle, and give it reports at the time when they were true"
            )
    noise = [_positive(t.noise, MOTION_UNITS[n], f"noise of {n}") for n, t in table.sensors.items()]
    period = [to_si(t.period, "s") for t in table.sensors.values()]
    densities = np.array([table.disturbance[n] for n in process.driven_names]) ** 2
    Observer(process, densities)
    return Design(
        table.name, process, tuple(channels), np.array(noise) ** 2, np.array(period, dtype=float), densities
    )


def _positive(value: Quantity, unit: str, what: str) -> float:
    found = to_si(value, unit)
    if not 0 < found < np.inf:
        raise UndertowError(f"{what} = {found:g} {unit}: give a standard deviation above zero")
    return found


def _refuse_alien(what: str, given: Mapping[str, object], known: tuple[str, ...]) -> None:
    for name in given:
        if name not in known:
            raise UndertowError(f"{what} '{name}' is none{nearest(name, known)}: they are {', '.join(known)}")
