"""The runs that docs/closed-loops.md tells of."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undertow.control.closed_loop import ClosedLoop, LoopResult, Overrides, Record, Scenario, without_effects
from undertow.control.gains import GainTable, load_gains
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Thruster, Value, Vehicle
from undertow.typing import Progress

PAPER = ("paper-pd", "paper-pid", "paper-smc")
CORIOLIS = ("rigid_body_coriolis", "added_mass_coriolis")
SIX = Path(__file__).parents[2] / "examples" / "mini-auv-6dof" / "vehicle.toml"
GOAL = (-1.0, 1.0, 1.0)
# The paper's equations have two sets of parameters and no value in between at rest: the forward one is taken.
CREEPING = {"u": 1e-12, "w": 1e-12}
RUN = Scenario(GOAL, moving=CREEPING)
AS_FILED = Overrides()
_SPREAD = ("X_udot", "X_u", "X_uabsu", "Z_wdot", "Z_w")


def model_9() -> Vehicle:
    """The bundled vehicle as (9) of the paper: without Coriolis terms."""
    return without_effects(load_vehicle("mini-auv"), CORIOLIS)


def paper_run() -> list[Record]:
    """The three controllers over 240 s at 1 ms."""
    return [AS_FILED.loop(name, model_9()).run(RUN) for name in PAPER]


def long_pid() -> Record:
    """The PID loop until its limit cycle has settled."""
    return AS_FILED.loop("paper-pid", model_9()).run(replace(RUN, duration=3000.0))


def predicted_cycle() -> tuple[float, float]:
    """Amplitude in m and period in s that the describing function of |u| u predicts for the PID surge loop.

    The drag of u = U sin(omega t) acts like a linear one of 8 / (3 pi) X_uabsu U, and the loop of
    M s^3 + K s^2 + k_p s + k_i swings on where K k_p = M k_i, with omega^2 = k_p / M. Of both sets of
    parameters the mean is taken.
    """
    vehicle, gains = model_9(), load_gains("paper-pid", model_9()).values
    x_udot, x_u, x_uu = (_mean(vehicle, name) for name in ("X_udot", "X_u", "X_uabsu"))
    mass = vehicle.value_of("m").value - x_udot
    omega = math.sqrt(gains["K_P_x"] / mass)
    needed = mass * gains["K_I_x"] / gains["K_P_x"] - gains["K_V_x"] + x_u
    return needed * 3 * math.pi / (8 * -x_uu * omega), 2 * math.pi / omega


def _mean(vehicle: Vehicle, name: str) -> float:
    return sum(vehicle.values[f"{name}_{way}"].value for way in ("forward", "backward")) / 2


# --- other readings -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Reading:
    """One way to read what the paper leaves open.

    Attributes
    ----------
    words : str
        What is read otherwise.
    overrides : Overrides
        Overrides of the command line.
    vehicle : callable
        The vehicle for it.
    gains : callable, optional
        Change of a gain file.
    scenario : Scenario
        The run.
    """

    words: str
    overrides: Overrides = AS_FILED
    vehicle: Callable[[], Vehicle] = model_9
    gains: Callable[[GainTable], GainTable] | None = None
    scenario: Scenario = RUN


def _one_set(way: str) -> Vehicle:
    """The vehicle with the parameters of one direction both ways."""
    vehicle = model_9()
    other = {"forward": "backward", "backward": "forward"}[way]
    values = {f"{n}_{other}": vehicle.values[f"{n}_{way}"] for n in _SPREAD}
    return vehicle.with_values(values)


def _yaw_gain(table: GainTable) -> GainTable:
    if table.law != "pid":
        return table
    stiff = {**table.gains["K_P"], "psi": "0.1 N m/rad"}  # type: ignore[dict-item]
    return table.model_copy(update={"gains": {**table.gains, "K_P": stiff}})


READINGS = (
    Reading("as in the table above"),
    Reading("heading by atan: -45°, backwards", Overrides(heading="atan")),
    Reading("K_P of the PID heading 0.1 instead of the printed 0.01", gains=_yaw_gain),
    Reading("the same, heading by atan", Overrides(heading="atan"), gains=_yaw_gain),
    Reading("integrals begin at t = 0", Overrides(integrators="start")),
    Reading("gate of 5°", Overrides(gate="5 deg")),
    Reading("gate of 0.1°", Overrides(gate="0.1 deg")),
    Reading("no schedule: all at once", Overrides(order="together")),
    Reading("a sway force", Overrides(sway="actuated")),
    Reading("a sway force, all at once", Overrides(sway="actuated", order="together")),
    Reading("a sway force, heading by atan", Overrides(sway="actuated", heading="atan")),
    Reading("with Coriolis terms", vehicle=lambda: load_vehicle("mini-auv")),
    Reading("forward parameters both ways", vehicle=lambda: _one_set("forward")),
    Reading("backward parameters both ways", vehicle=lambda: _one_set("backward")),
    Reading("sampled every 10 ms", scenario=replace(RUN, dt=0.01)),
    Reading("sampled every 0.1 ms", scenario=replace(RUN, dt=1e-4)),
)


@dataclass(frozen=True)
class Read:
    """What a reading gives for the three controllers."""

    words: str
    results: tuple[LoopResult, ...]

    @property
    def as_the_paper_says(self) -> bool:
        """Whether PD and SM swing past the goal by more than 2%, and PID does not."""
        pd, pid, sm = (self.overshoot(r) > 2 for r in self.results)
        return pd and sm and not pid

    @staticmethod
    def overshoot(result: LoopResult) -> float:
        """The larger overshoot of x and y, %."""
        return max(result.of(n).overshoot or 0.0 for n in "xy")

    @staticmethod
    def settling(result: LoopResult) -> float | None:
        """When both x and y have settled, s."""
        times = [result.of(n).settling for n in "xy"]
        return None if None in times else max(t for t in times if t is not None)


def read(report: Progress) -> list[Read]:
    """Every reading."""
    found = []
    for i, reading in enumerate(READINGS):
        report(i / len(READINGS), f"readings: {reading.words}")
        found.append(Read(reading.words, tuple(_results(reading))))
    return found


def _results(reading: Reading) -> Iterator[LoopResult]:
    vehicle = reading.overrides.with_sway(reading.vehicle())
    for name in PAPER:
        gains = load_gains(name, vehicle, lambda t: _changed(t, reading))
        yield ClosedLoop(gains).run(reading.scenario).result


def _changed(table: GainTable, reading: Reading) -> GainTable:
    own = reading.overrides.applied_to(table)
    return reading.gains(own) if reading.gains else own


# --- the sampled sign ----------------------------------------------------------------------------------
def sampled_signs() -> list[tuple[float, str, LoopResult]]:
    """Sliding mode at several sampling intervals; at 1 ms also with the mean set of parameters at rest."""
    loop = AS_FILED.loop("paper-smc", model_9())
    forward = [(dt, "forward", loop.run(replace(RUN, dt=dt, duration=80.0)).result) for dt in _INTERVALS]
    mean = loop.run(replace(RUN, moving={}, duration=80.0)).result
    return [forward[0], (1e-3, "mean of both", mean), *forward[1:]]


_INTERVALS = (1e-3, 1e-4, 1e-5)


# --- six degrees of freedom ------------------------------------------------------------------------------
def six(report: Progress) -> list[tuple[str, list[Record]]]:
    """The three controllers on variants of the vehicle in six degrees of freedom."""
    vehicle = load_vehicle(SIX)
    level, deep = _below(vehicle, 0.0), _below(vehicle, 0.02)
    weight = vehicle.value_of("B").value
    variants = {
        "4 degrees of freedom, (9)": model_9(),
        "4, with Coriolis terms": load_vehicle("mini-auv"),
        "6 as assumed": level,
        "6, l_zd = 2 cm": deep,
        "6, l_zd = 2 cm, buoyancy 1 cm up": deep.with_values({"S_z": Value(0.01 * weight)}),
        "6, d = 1 cm": _with_torque(level, 0.01),
    }
    pairs = {words: (model_9(), moving) for words, moving in variants.items()}
    pairs["6, d = 1 cm, which the allocation knows"] = (
        _with_torque(model_9(), 0.01),
        variants["6, d = 1 cm"],
    )
    found = []
    for i, (words, (known, moving)) in enumerate(pairs.items()):
        report(i / len(pairs), f"6 degrees of freedom: {words}")
        found.append((words, [AS_FILED.loop(n, known, moving).run(RUN) for n in PAPER]))
    return found


def _below(vehicle: Vehicle, height: float) -> Vehicle:
    """The vehicle with its forward thrusters below the centre of gravity: l_zd of (5), m."""
    thrusters = tuple(_lowered(t, height) for t in vehicle.thrusters)
    return replace(vehicle, thrusters=thrusters)


def _lowered(thruster: Thruster, height: float) -> Thruster:
    wrench = list(thruster.wrench)
    wrench[4] += height * wrench[0]
    return replace(thruster, wrench=tuple(wrench))


def _with_torque(vehicle: Vehicle, length: float) -> Vehicle:
    return vehicle.with_effect(catalogue()["reaction_torque"], {"d_reaction": Value(length)})


def tilt(record: Record) -> tuple[float, float]:
    """Largest roll and pitch, degrees."""
    angles = [record.state.get(name, np.zeros(1)) for name in ("phi", "theta")]
    roll, pitch = (float(np.rad2deg(np.abs(a).max())) for a in angles)
    return roll, pitch
