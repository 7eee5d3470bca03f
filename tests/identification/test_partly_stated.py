"""An effect of which the vehicle file states only some coefficients, beside another one that is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import undertow as ut
from undertow.model.vehicle import Value, Vehicle

STEP = 0.1


def _logs(vehicle: Vehicle, count: int, seconds: float) -> list[ut.Run]:
    """Runs with commands held for four seconds each, and a small slow force that is not logged."""
    model, rng = ut.compile(vehicle), np.random.default_rng(3)
    steps, half, inputs = round(seconds / STEP), len(vehicle.pose_names), len(model.inputs)
    runs = []
    for i in range(count):
        u = np.repeat(rng.uniform(-2.0, 2.0, (steps // 40 + 1, inputs)), 40, axis=0)[:steps]
        slow = np.zeros((steps, inputs))
        for k in range(1, steps):
            slow[k] = 0.97 * slow[k - 1] + 0.01 * rng.standard_normal(inputs)
        x = model.simulate(np.zeros(len(model.states)), u + slow, STEP)[:steps, : 2 * half]
        motion = dict(zip((*vehicle.pose_names, *vehicle.velocity_names), x.T, strict=True))
        noisy = {n: y + 0.002 * np.std(y) * rng.standard_normal(steps) for n, y in motion.items()}
        commands = dict(zip(vehicle.command_names, u.T, strict=True))
        runs.append(ut.Run(f"run {i}", STEP * np.arange(steps), noisy | commands, sha256=f"{i}"))
    return runs


def test_what_frees_a_coefficient_of_a_stated_effect_is_found_once_and_the_next_effect_beside_it() -> None:
    whole, known = ut.load_vehicle("cybership2"), ut.catalogue()
    force = known["constant_force"]
    runs = _logs(
        whole.with_effect(force, {n: Value(0.1 * (n == "Y_0")) for n in ("X_0", "Y_0", "N_0")}), 4, 120.0
    )
    file = replace(whole, values={n: v for n, v in whole.values.items() if n != "Y_vabsv"})
    effects = {n: known[n] for n in ("quadratic_damping", "constant_force")}
    found = ut.diagnose(file, runs[:3], runs[3:], known=effects).diagnosis
    assert found.effects == ["quadratic_damping"]
    assert found.verdict == "missing_effect"
    assert [a.effect for a in found.added] == ["quadratic_damping", "constant_force"]
    (drag,) = [p for p in found.parameters if p.name == "Y_vabsv"]
    assert abs(drag.value + 36.47) < 3.0 * max(drag.standard_error, 1.0)
