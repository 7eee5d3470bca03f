"""How long a vehicle takes from its effects to running code, and what a simulation costs.

    python -m benchmarks.codegen_speed

The vehicle has six degrees of freedom, six thrusters and every effect of the catalogue. "cold" starts with an
empty cache, "warm" finds the compiled libraries there; each is a process of its own, and importing packages
is not counted. Simulations are compared with two ways to write them in Python, in the same run on the same
machine: a Runge-Kutta loop in NumPy, and SciPy's solve_ivp from sample to sample, both around the right-hand
side that SymPy prints for NumPy.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
import sympy as sm
from scipy.integrate import solve_ivp

from undertow.codegen import Compiled, Functions, Simulator
from undertow.model.catalogue import catalogue
from undertow.model.symbols import DOFS, symbol
from undertow.model.vehicle import Thruster, Vehicle

TARGETS = {"cold": 10.0, "warm": 0.5}
INTERVAL = 0.05
SAMPLES = 2001
KINDS = ("dynamics", "jacobians", "regressor", "residual", "outputs")


def full_vehicle() -> Vehicle:
    """Six degrees of freedom, six thrusters, every effect."""
    rng = np.random.default_rng(1)
    thrusters = tuple(Thruster(f"T{k}", tuple(rng.uniform(-1, 1, 6).round(3))) for k in range(1, 7))
    names = tuple(t.name for t in thrusters)
    effects = tuple(cls(names) for cls in catalogue().values() if not cls.built_in)
    return Vehicle("every effect", DOFS, effects, {}, thrusters)


def parameters(functions: Functions) -> np.ndarray:
    """Values of a plausible vehicle: heavy enough, and damped."""
    known = {
        "m": 25.0,
        "I_x": 7.0,
        "I_y": 8.0,
        "I_z": 9.0,
        "rho": 1000.0,
        "g": 9.81,
        "T_lag": 0.5,
        "T_memory": 2.0,
    }
    declared = functions.vehicle.declared_parameters
    damping = {n: -0.5 for n, p in declared.items() if p.bounds[1] == 0}
    return np.array([(damping | known).get(n, 0.05) for n in functions.parameter_names])


# --- from effects to running code ---------------------------------------------------------------


def time_build() -> None:
    """Time the steps in this process and print them."""
    vehicle = full_vehicle()
    total = 0.0
    for what, action in _steps(vehicle).items():
        seconds = _seconds(action)
        total += seconds
        print(f"  {what:45s}{seconds:8.3f} s")
    print(f"  {'total':45s}{total:8.3f} s")


def _steps(vehicle: Vehicle) -> dict[str, Callable[[], object]]:
    functions: list[Functions] = []
    simulators: list[Simulator] = []
    steps: dict[str, Callable[[], object]] = {
        "derive the model": lambda: functions.append(Functions(vehicle)),
        "simulation": lambda: simulators.append(Simulator(functions[0], compiled=True)),
        "simulation with sensitivities": lambda: simulators[0].run_with_sensitivities(
            *_rest(functions[0]), [0]
        ),
    }
    for kind in KINDS:
        steps[f"{kind} for CasADi"] = lambda kind=kind: getattr(Compiled(functions[0], compiled=True), kind)
    return steps


def _rest(functions: Functions) -> tuple[np.ndarray, ...]:
    x0, u = np.zeros(len(functions.state_names)), np.zeros((2, functions.u.numel()))
    return x0, np.array([0.0, 0.1]), u, parameters(functions)


def _seconds(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def report_builds() -> None:
    """Cold and warm, each in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        for state, target in TARGETS.items():
            print(f"{state} (target: {target:g} s)", flush=True)
            environment = {**os.environ, "XDG_CACHE_HOME": folder}
            subprocess.run([sys.executable, "-m", __spec__.name, "--build"], check=True, env=environment)


# --- simulation ---------------------------------------------------------------------------------


def sympy_rates(functions: Functions) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """x_dot(x, u, p) as SymPy prints it for NumPy, M solved in every call."""
    c = functions.vehicle.composition
    chain, rates, _ = c.chain
    delivered = dict(zip(c.signals.actuation, chain, strict=True))
    rest = dict.fromkeys(c.nu_dot, sm.Integer(0))
    mass = -c.residual.jacobian(c.nu_dot)
    forcing = c.residual.xreplace(rest).xreplace(delivered)
    owned = sm.Matrix([*(r.xreplace(delivered) for r in c.wrench_states.values()), *rates.values()])
    states = [*c.eta, *c.nu, *c.wrench_states, *rates]
    groups = [states, list(c.commands), [symbol(n) for n in functions.parameter_names]]
    evaluate = sm.lambdify(groups, [mass, forcing, c.pose_rate, owned], modules="numpy", cse=True)

    def x_dot(x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        m, f, pose, more = evaluate(x, u, p)
        return np.concatenate([pose[:, 0], np.linalg.solve(m, f)[:, 0], more[:, 0]])

    return x_dot


def loop_in_numpy(rates, x: np.ndarray, u: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    """End of a Runge-Kutta simulation, one step for each input."""
    for held in u:
        k1 = rates(x, held, p)
        k2 = rates(x + h / 2 * k1, held, p)
        k3 = rates(x + h / 2 * k2, held, p)
        k4 = rates(x + h * k3, held, p)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def loop_in_scipy(rates, x: np.ndarray, u: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    """End of a simulation by solve_ivp, restarted at every change of the inputs."""
    for held in u:
        x = solve_ivp(lambda _, y, held=held: rates(y, held, p), (0, h), x).y[:, -1]
    return x


def report_simulations() -> None:
    """The same 100 s four ways."""
    functions = Functions(full_vehicle())
    p = parameters(functions)
    t = INTERVAL * np.arange(SAMPLES)
    u = np.random.default_rng(2).normal(size=(SAMPLES, functions.u.numel()))
    x0 = np.zeros(len(functions.state_names))
    simulator = Simulator(functions, compiled=True)
    simulator.run_with_sensitivities(x0, t[:2], u[:2], p, [0])  # compiles
    compiled = min(_seconds(lambda: simulator.run(x0, t, u, p)) for _ in range(9))
    end = simulator.run(x0, t, u, p)
    few = 101  # the others are slow: a twentieth of the time is enough
    rates = sympy_rates(functions)
    virtual = Simulator(functions, compiled=False)
    rivals = {
        "CasADi virtual machine, NumPy Runge-Kutta": lambda: virtual.run(x0, t[:few], u[:few], p)[-1],
        "SymPy for NumPy, Runge-Kutta loop": lambda: loop_in_numpy(rates, x0, u[: few - 1], p, INTERVAL),
        "SymPy for NumPy, solve_ivp": lambda: loop_in_scipy(rates, x0, u[: few - 1], p, INTERVAL),
    }
    print(f"simulation, {len(x0)} states, {p.size} parameters, {SAMPLES - 1} steps of {INTERVAL:g} s")
    print(
        f"  {'compiled':45s}{1e3 * compiled:8.2f} ms  {1e9 * compiled / 4 / (SAMPLES - 1):5.0f} ns per x_dot"
    )
    for name, run in rivals.items():
        results: list[np.ndarray] = []
        seconds = _seconds(lambda run=run, results=results: results.append(run())) * (SAMPLES - 1) / (few - 1)
        apart = np.abs(results[0] - end[few - 1]).max()
        print(
            f"  {name:45s}{1e3 * seconds:8.0f} ms  {seconds / compiled:5.0f} times as long, {apart:.0e} apart"
        )
    for columns in (10, 40):
        problem = (x0, t, u, p, range(columns))
        seconds = _seconds(lambda problem=problem: simulator.run_with_sensitivities(*problem))
        faster = (columns + 1) * compiled / seconds
        name = f"compiled, with {columns} sensitivities"
        print(f"  {name:45s}{1e3 * seconds:8.1f} ms  {faster:5.1f} times as fast as differences")


if __name__ == "__main__":
    if sys.argv[1:] == ["--build"]:
        time_build()
    else:
        report_builds()
        report_simulations()
