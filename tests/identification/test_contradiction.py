"""What in the forces speaks against an effect that would be named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
import sympy as sm

import undertow as ut
from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from tests.quick import first_quick
from undertow.identification.diagnose import diagnose
from undertow.identification.diagnosis.bench import Bench, error_falls, open_bench
from undertow.identification.diagnosis.consistency import Kept, kept_with
from undertow.identification.diagnosis.evidence import FoundEffect, reconciles_sensors
from undertow.identification.diagnosis.residual import remaining, unrelated_to
from undertow.identification.diagnosis.rounds import try_all
from undertow.identification.diagnosis.validation import SimulationValidator
from undertow.identification.logs.run import Run
from undertow.identification.report.scaffold import effect_of
from undertow.identification.result_builder import contradiction
from undertow.model.catalogue import catalogue
from undertow.model.effect import Parameter, Signals, Wrench
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle


class _Tried(NamedTuple):
    """An effect on a bench, as if it were the one to be named."""

    finding: FoundEffect
    bench: Bench
    validator: SimulationValidator

    @property
    def doubt(self) -> str:
        fits = self.bench.base, self.finding.trial.fit
        return contradiction(self.finding, fits, self.bench, self.validator)

    @property
    def kept(self) -> Kept:
        """Size and gain of the effect beside a force made of what else remains, as shares of those alone."""
        vehicle, train = self.bench.base.model.functions.vehicle, self.bench.train
        base = self.validator.final(self.bench.base)
        left = unrelated_to({"u", "v"}, remaining(base, train, train), vehicle)
        effect = effect_of(left, 50.0)
        assert effect.about().startswith("a force that varies with")
        other = try_all(self.bench, {effect.id: effect}, lambda done, words: None).findings[0]
        assert other.explained > 0.15
        return kept_with(self.finding, other, base, self.bench, self.validator)


@cache
def _tried(hidden: tuple[str, ...], effect: str, of: str = "usv") -> _Tried:
    case = make_case(of, hidden, 5, duration=50.0)
    given, runs = vehicle_of(case), runs_of(case)
    bench = open_bench(given, *prepared(given, runs[:3], runs[3:]))
    found = try_all(bench, {effect: catalogue()[effect]}, lambda done, words: None)
    validator = SimulationValidator(given, runs[:3], runs[3:], bench.train.sigma)
    return _Tried(found.findings[0], found.bench, validator)


def test_the_error_relative_to_sensor_noise_falls_with_the_missing_effect_and_rises_without_it() -> None:
    tried = _tried(("lift",), "lift")
    fits, test = (tried.bench.base, tried.finding.trial.fit), tried.bench.test
    assert error_falls(*fits, test)
    assert not error_falls(*fits[::-1], test)
    assert not error_falls(fits[0], fits[0], test)


def test_an_effect_that_leaves_the_force_as_large_is_in_doubt() -> None:
    assert _tried(("periodic_side_force",), "lift").doubt.startswith("it improves only the simulations")


@pytest.mark.slow
def test_what_makes_up_for_a_part_of_a_periodic_force_is_not_there_beside_it() -> None:
    kept = _tried(("periodic_side_force",), "lift").kept
    assert abs(kept.size) < 0.2
    assert kept.gain < 0.2


@pytest.mark.slow
def test_a_periodic_force_beside_an_effect_takes_nothing_of_it() -> None:
    tried = _tried(("lift", "periodic_side_force"), "lift")
    assert tried.kept.size == pytest.approx(1.0, abs=0.45)
    assert tried.kept.gain > 0.7
    assert tried.doubt == ""


@pytest.mark.slow
def test_buoyancy_does_not_fall_with_depth_where_a_weight_was_dropped() -> None:
    """A vehicle that sinks from then on is deeper, the later it is."""
    doubt = _tried(("dropped_weight",), "hull_compressibility", "float").doubt
    assert doubt.startswith("with a force that varies with a step at 3")
    assert "its size would drop to" in doubt


@pytest.mark.parametrize("of", first_quick(["float", "usv"]))
def test_thrust_does_not_fade_where_drag_grows(of: str) -> None:
    """Both know the time; that the force goes with the speed, too, is news to thrust."""
    doubt = _tried(("growing_drag",), "supply_droop", of).doubt
    assert doubt.startswith("with a force that varies with t ")
    assert "its size would drop to" in doubt


def test_drag_of_drift_and_turning_is_not_blamed_for_damping_by_thrust() -> None:
    """Where sideways motion follows the thrust, |v| r is a fair copy of r times the thrust of all thrusters.

    A fit of simulations has far other inertia and damping: that no term is significant beside them is due to
    these, not to the term.
    """
    doubt = _tried(("damping_by_thrust",), "quadratic_damping_coupling", "micro-auv").doubt
    assert doubt.startswith("with a force that varies with r times each |command|")
    assert "its size would drop to 0%" in doubt


@pytest.mark.parametrize("of", first_quick(["float", "usv"]))
def test_thrust_fades_where_it_does(of: str) -> None:
    assert _tried(("supply_droop",), "supply_droop", of).doubt == ""


def test_nothing_speaks_against_an_effect_that_is_there() -> None:
    assert _tried(("lift",), "lift").doubt == ""


@pytest.mark.parametrize("effect", ["added_mass", "entrained_water"])
def test_a_share_of_what_drives_a_vehicle_does_not_speak_against_mass(effect: str) -> None:
    """Of a box on a rail, mass that is missing looks like a smaller force of its one actuator."""
    assert _tried(("no_added_mass",), effect, "box").doubt == ""


@pytest.mark.slow
def test_a_rudder_is_not_blamed_for_a_periodic_force() -> None:
    """By chance fins go with it a little: the force gets smaller by 2%, and predictions no better."""
    case = make_case("torpedo", ("periodic_side_force",), 12120427)
    runs, known = runs_of(case), {"rudder_force": catalogue()["rudder_force"]}
    found = diagnose(vehicle_of(case), runs[:3], runs[3:], known=known).diagnosis
    assert (found.verdict, found.effects) == ("unexplained", [])
    assert found.ranking[0].not_named.startswith("increases the prediction error")


@pytest.mark.parametrize(
    ("hidden", "effect", "reconciles"),
    [("sensor_bias", "sensor_bias", True), ("lift", "lift", False), ("lift", "sensor_bias", False)],
)
def test_no_missing_force_makes_pose_and_velocities_contradict(
    hidden: str, effect: str, reconciles: bool
) -> None:
    tried = _tried((hidden, "periodic_side_force"), effect)
    assert reconciles_sensors(tried.finding, tried.bench) is reconciles


class FallingThrust(Wrench):
    """Thrust that falls with the speed ahead, at any load alike: no effect of the catalogue does."""

    id = "falling_thrust"
    family = "actuation"
    reference = "none: for this test"
    signature = "top speed is lower than thrust at rest suggests"

    fall = Parameter("s/m", "fraction of the thrust lost per m/s")

    def wrench(self, s: Signals) -> sm.Matrix:
        return -self.fall * s.nu_r[0] * self.allocation * s.actuation


@pytest.mark.slow
def test_drag_is_not_blamed_for_thrust_that_falls_with_speed() -> None:
    """Of a boat that goes ahead most of the time: then thrust and drag nearly go together."""
    otter = load_vehicle("otter")
    effects = (*otter.effects, FallingThrust(otter.command_names))
    true = replace(otter, effects=effects, values={**otter.values, "fall": Value(0.35)})
    runs = [_run_of(true, seed) for seed in range(4)]
    known = {i: catalogue()[i] for i in ("cubic_damping", "quadratic_damping", "thrust_loss", "lift")}
    found = diagnose(otter, runs[:3], runs[3:], known=known).diagnosis
    assert found.effects == []
    (surge,) = (r for r in found.remaining if r.degree_of_freedom == "surge")
    assert surge.depends_on[0].term == "u times each command"
    assert "u times each command" in found.ranking[0].not_named, found.ranking[0].effect


def _run_of(vehicle: Vehicle, seed: int) -> Run:
    """100 s of random steps of thrust, mostly ahead, with noise."""
    rng, dt = np.random.default_rng(seed), 0.1
    u = np.repeat(rng.uniform(-20.0, 80.0, (25, 2)), 40, axis=0)
    x = ut.compile(vehicle).simulate(np.zeros(6), u, dt)[: len(u)]
    x = x + rng.standard_normal(x.shape) * [0.02, 0.02, 0.003, 0.01, 0.01, 0.003]
    names = (*vehicle.pose_names, *vehicle.velocity_names, *vehicle.command_names)
    return Run(f"run{seed}", dt * np.arange(len(u)), dict(zip(names, np.hstack([x, u]).T, strict=True)))
