"""Random vehicles with random gains: loops that `undertow gains` says yes of are simulated from their region.

    python -m benchmarks.certificates --cases 200 --seed 1

Prints one line for each case whose certified loop does not come to its set-point, with the folder of its
files, and a summary: how many were certified, and why the others were refused.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import beta

from benchmarks.attacks import Attack, Target, target_of
from undertow.control.closed_loop.scenario import Scenario
from undertow.control.closed_loop.simulate import ClosedLoop
from undertow.control.conditions.channels import coupled, linear_channels
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.problem import Problem, Uncertainty
from undertow.control.conditions.result import Report
from undertow.control.gains import GainSet, allocation_of, load_gains
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle

Array = np.ndarray
AXES = {
    "surge": ("X", "u", "x"), "sway": ("Y", "v", "y"), "heave": ("Z", "w", "z"),
    "roll": ("K", "p", "phi"), "pitch": ("M", "q", "theta"), "yaw": ("N", "r", "psi"),
}  # fmt: skip
SETS = (
    ("surge",), ("heave",), ("surge", "sway", "yaw"), ("surge", "sway", "heave", "yaw"),
    ("surge", "sway", "heave", "roll", "pitch", "yaw"),
)  # fmt: skip
LONGEST = 6000.0  # s of simulation; slower loops are not called stable or unstable by it
ATTACKED = 600.0  # s of an attack's simulations, of which there are many
SPREAD = 0.05  # share of their values within which parameters are uncertain in the second certificate
# Words of a refusal, and what stands in the table.
CAUSES = (
    ("whose limit is", "a command meets its limit"),
    ("takes all of a thruster", "a command meets its limit"),
    ("have to be left for control", "a command meets its limit"),
    ("is not stable", "unstable at rest"),
)
LAWS = ("pd", "pid", "sliding-mode", "sliding-mode-boundary-layer", "super-twisting")


@dataclass(frozen=True)
class Case:
    """A vehicle file and a gain file."""

    vehicle: str
    gains: str


# --- drawing --------------------------------------------------------------------------------------
def draw(rng: np.random.Generator, effects: bool) -> Case:
    """A vehicle of some kilograms to some tons with gains of all sizes, and effects if wanted."""
    dofs = SETS[rng.choice(len(SETS), p=(0.1, 0.1, 0.25, 0.4, 0.15))]
    size = float(10 ** rng.uniform(-0.7, 0.5))  # length, m
    m = 100 * size**3 * float(rng.uniform(0.5, 2))
    inertia = m * size**2 * rng.uniform(0.05, 0.12, 3)
    lines = [
        'schema = "undertow/vehicle/1"', 'name = "drawn"',
        f"degrees_of_freedom = [{', '.join(repr(d) for d in dofs)}]".replace("'", '"'),
        'signs = "sname"', "[effects.rigid_body]", f"m = {m:.6g}",
    ]  # fmt: skip
    lines += [f"I_{a} = {i:.6g}" for a, i in zip("xyz", inertia, strict=True)]
    lines += _hull(rng, dofs, m, size)
    lines += _thrusters(rng, dofs, m, size)
    lines += _more(rng, m) if effects else []
    return Case("\n".join(lines), _gains(rng, dofs, m, size))


def _hull(rng: np.random.Generator, dofs: tuple[str, ...], m: float, size: float) -> Iterator[str]:
    def each(name: str, low: float, high: float, turn: float) -> Iterator[str]:
        for d in dofs:
            force, speed, _ = AXES[d]
            value = -m * float(10 ** rng.uniform(low, high)) * (size**turn if force in "KMN" else 1.0)
            key = name.format(F=force, v=speed)
            if rng.random() < 0.3:
                yield f"{key} = {{ forward = {value:.6g}, backward = {value * rng.uniform(0.6, 1.5):.6g} }}"
            else:
                yield f"{key} = {value:.6g}"

    yield "[effects.rigid_body_coriolis]"
    yield "[effects.added_mass]"
    yield from each("{F}_{v}dot", -1.0, 0.2, 2)
    yield "[effects.added_mass_coriolis]"
    yield "[effects.linear_damping]"
    yield from each("{F}_{v}", -2.0, 0.3, 2)
    if rng.random() < 0.7:
        yield "[effects.quadratic_damping]"
        yield from each("{F}_{v}abs{v}", -2.0, 0.5, 2)
    if {"surge", "sway", "yaw"} <= set(dofs) and rng.random() < 0.5:
        yield "[effects.lift]"
        yield from (
            f"{k} = {m / size * rng.normal(0, 0.5) * f:.6g}"
            for k, f in (("Y_uv", 1), ("N_uv", size), ("N_ur", size))
        )
    if "roll" in dofs:
        yield from (
            "[effects.restoring]",
            f"W = {m * 9.81:.6g}",
            f"B = {m * 9.81 * rng.uniform(0.98, 1.02):.6g}",
        )
        yield f"z_b = {-size * rng.uniform(-0.005, 0.05):.6g}"
    elif "heave" in dofs and rng.random() < 0.5:
        yield from ("[effects.net_buoyancy]", f"B_net = {m * 9.81 * rng.normal(0, 0.02):.6g}")


def _thrusters(rng: np.random.Generator, dofs: tuple[str, ...], m: float, size: float) -> Iterator[str]:
    limited = rng.random() < 0.6
    for i, d in enumerate(dofs):
        if len(dofs) > 2 and d in ("sway", "heave") and rng.random() < 0.1:
            continue
        wrench = [0.0] * 6
        wrench["XYZKMN".index(AXES[d][0])] = 1.0 if AXES[d][0] in "XYZ" else size / 2
        yield from ("[[thrusters]]", f'name = "f{i}"', f"wrench = {wrench}")
        if limited:
            yield f"limit = {m * float(10 ** rng.uniform(-1.5, 0.5)):.6g}"


def _more(rng: np.random.Generator, m: float) -> list[str]:
    """One effect that no condition knows, from harmless to fatal."""

    def log(low: float, high: float) -> float:
        return float(10 ** rng.uniform(low, high))

    found: dict[str, dict[str, float]] = {
        "thruster_lag": {"T_lag": log(-1.5, 1)},
        "actuation_delay": {"delay": log(-1.5, 0.5)},
        "sensor_delay": {"velocity_delay": log(-1.5, 0.5)},
        "attitude_bias": {"b_psi": rng.normal(0, 1)},
        "ocean_current": {"V_N": rng.normal(0, 0.2), "V_E": rng.normal(0, 0.2)},
        "velocity_lever_arm": {"x_s": rng.normal(0, 0.5), "y_s": rng.normal(0, 0.5)},
        "position_lever_arm": {"x_fix": rng.normal(0, 0.5), "y_fix": rng.normal(0, 0.5)},
        "velocity_misalignment": {"turn_z": rng.normal(0, 0.7)},
        "sensor_bias": {"b_u": rng.normal(0, 0.1)},
        "sensor_scale": {"scale_velocity": rng.uniform(-0.8, 2)},
        "thruster_deadband": {"deadband_width": m * log(-3, 0)},
        "thruster_saturation": {"saturation_limit": m * log(-2, 0.5)},
        "thruster_asymmetry": {"reverse_loss": rng.uniform(0, 1)},
        "thruster_gain": {"gain_error_f0": rng.uniform(-1, 0.5)},
        "supply_droop": {"droop_rate": log(-4, -2)},
        "dry_friction": {"X_signu": -m * log(-3, 0)},
        "constant_force": {"X_0": m * rng.normal(0, 0.3)},
    }
    chosen = str(rng.choice(list(found)))
    return [f"[effects.{chosen}]", *(f"{k} = {v:.6g}" for k, v in found[chosen].items())]


def _gains(rng: np.random.Generator, dofs: tuple[str, ...], m: float, size: float) -> str:
    law = str(rng.choice(LAWS, p=(0.3, 0.4, 0.1, 0.1, 0.1)))
    own = {d: float(10 ** rng.uniform(-1.3, 0.3)) for d in dofs}  # natural frequency, rad/s
    if rng.random() < 0.6 and {"surge", "sway"} <= set(dofs):
        own |= dict.fromkeys({"surge", "sway", "heave"} & set(dofs), own["surge"])
    damping = {d: float(10 ** rng.uniform(-1.0, 0.5)) for d in dofs}
    if rng.random() < 0.6:
        damping = dict.fromkeys(dofs, damping[dofs[0]])
    integral = float(10 ** rng.uniform(-2.5, 0))
    rows: dict[str, dict[str, float]] = {}
    for d in dofs:
        scale = m * (size**2 / 12 if AXES[d][0] in "KMN" else 1.0) * 1.5
        w, z, c = own[d], damping[d], AXES[d][2]
        rows.setdefault("K_P", {})[c] = scale * w**2
        rows.setdefault("K_V", {})[c] = scale * 2 * z * w
        rows.setdefault("K_I", {})[c] = scale * w**3 * integral
        rows.setdefault("K_Z", {})[c] = w**2 / 5
        rows.setdefault("Lambda", {})[c] = w
        rows.setdefault("width", {})[c] = w / 20
        rows.setdefault("K_1", {})[c] = w
        rows.setdefault("K_2", {})[c] = w**2 / 10
    wanted = {
        "pd": ("K_P", "K_V"), "pid": ("K_P", "K_V", "K_I"), "sliding-mode": ("K_Z", "Lambda"),
        "sliding-mode-boundary-layer": ("K_Z", "Lambda", "width"), "super-twisting": ("K_1", "K_2", "Lambda"),
    }[law]  # fmt: skip
    lines = ['schema = "undertow/gains/1"', 'name = "drawn"', f'law = "{law}"']
    return "\n".join([*lines, "UNACTUATED", "[gains]"]) + "".join(
        f"\n{g} = {{ {', '.join(f'{c} = {v:.6g}' for c, v in rows[g].items())} }}" for g in wanted
    )


# --- judging --------------------------------------------------------------------------------------
def load(case: Case, folder: Path) -> GainSet:
    """The gain set of a case; axes without a thruster are named as such."""
    (folder / "v.toml").write_text(case.vehicle)
    vehicle = load_vehicle(folder / "v.toml")
    pushed = {"XYZKMN"[i] for t in vehicle.thrusters for i, w in enumerate(t.wrench) if w}
    silent = [d for d in vehicle.degrees_of_freedom if AXES[d][0] not in pushed]
    named = "unactuated = [" + ", ".join(f'"{d}"' for d in silent) + "]" if silent else ""
    (folder / "g.toml").write_text(case.gains.replace("UNACTUATED", named))
    return load_gains(folder / "g.toml", vehicle)


def box_of(gains: GainSet, share: float) -> dict[str, float]:
    """The stated start box: a share of the length of a cube as heavy as 100 kg/m^3, and that share in rad."""
    length = (gains.plant.vehicle.value_of("m").value / 100) ** (1 / 3)
    names = gains.plant.vehicle.pose_names
    return {c: share if c in ("phi", "theta", "psi") else share * length for c in names}


def called_stable(
    gains: GainSet, box: dict[str, float], roots: list[complex], rng: np.random.Generator
) -> str:
    """What linearisation and simulation of corners of the box say: "stable", "limited", or why not.

    Both at the headings of the set-point that a certificate is for: all of them.
    """
    slowest = -max(r.real for r in roots)
    if slowest <= 0:
        return "unstable at rest"
    duration = max(12 / slowest, 60.0)
    if duration > LONGEST:
        return "too slow to simulate"
    corners = rng.choice((-1.0, 1.0), (16, len(box))) * list(box.values())
    most = 0.0
    try:
        loop = ClosedLoop(gains)
        for heading in headings_of(box):
            left, used = _run(loop, corners, duration, heading)
            if left > 0.3:
                return "does not come back"
            most = max(most, used)
    except UndertowError:
        return "not simulated"
    return "stable" if most < 1 else "limited"


def roots_of(gains: GainSet) -> list[complex]:
    """Roots of the loop at rest, all axes together at the worst of 18 headings where they matter."""
    problem = Problem(gains)
    each = [c.roots for c in linear_channels(problem)]
    return [r for roots in (*each, *coupled(problem).values()) for r in roots]


def headings_of(box: dict[str, float]) -> Array:
    """Headings of the set-point, as attacks have them."""
    count = Attack().headings if "psi" in box else 1
    return np.arange(count) * 2 * np.pi / Attack().headings + (0.3 if count > 1 else 0.0)


def _run(loop: ClosedLoop, corners: Array, duration: float, heading: float) -> tuple[float, float]:
    """The largest error left of these errors at a set-point at rest, and the largest command by its limit."""
    names, limits = loop.vehicle.pose_names, allocation_of(loop.gains).limits
    place = np.array([heading if c == "psi" else 0.0 for c in names])
    first = dict(zip(names, (place - corners).T, strict=True))
    runs = loop.run_many(Scenario(tuple(place), duration, 0.02), starts=first)
    pairs = zip(loop.gains.plant.vehicle.command_names, limits, strict=True)
    used = [float(np.abs(runs.command(c)).max() / m) for c, m in pairs if np.isfinite(m)]
    left = np.abs(place - runs.states[:, -1, : len(names)]).max(axis=1) / np.abs(corners).max(axis=1)
    return float(np.nan_to_num(left, nan=np.inf).max()), max(used, default=0.0)


def starts(gains: GainSet, report: Report, count: int, rng: np.random.Generator) -> dict[str, Array]:
    """States on the border of the certified region, integrals at zero; some metres where it is everywhere."""
    vehicle, region = gains.plant.vehicle, report.region
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    n = len(vehicle.pose_names)
    z = rng.normal(size=(count, 2 * n))
    z[: count // 2, n:] = 0.0
    angles = np.array([c in ("phi", "theta", "psi") for c in vehicle.pose_names])
    tame = np.where(angles, 0.9, 1.0)
    if region.level is None or region.level > 1e6:
        most = np.array([min(region.errors.get(c, 2.0), 2.0) for c in vehicle.pose_names]) * tame * 0.99
        fast = np.array([min(region.speeds.get(v, 0.5), 0.5) for v in vehicle.velocity_names]) * 0.3
        if "Lambda" in {g.name for g in type(gains.law).gains}:
            fast = fast * 0.0
        z = rng.choice((-1.0, 1.0), z.shape) * np.concatenate([most, fast])
        return dict(zip(names, z.T, strict=True))
    z *= np.concatenate(
        [[region.errors[c] for c in vehicle.pose_names], [region.speeds[v] for v in vehicle.velocity_names]]
    )
    if region.quadratic is not None:
        place = np.zeros(n)
        levels = Target(gains, report, 1.0, False, Attack()).value(z[:, None], 0 * z[:, None, :n], place)[
            :, 0
        ]
    else:
        levels = np.array([_level(gains, row) for row in z])
    z *= np.sqrt(0.98 * region.level / levels)[:, None]
    return dict(zip(names, z.T, strict=True))


def _level(gains: GainSet, state: Array) -> float:
    """V of a state: pose as the error from a set-point at zero."""
    plant, n = gains.plant, len(gains.plant.nu)
    way = {v: 1 if state[n + list(plant.nu).index(v)] > 0 else -1 for v in plant.reversing}
    M = np.array(plant.with_signs(plant.M, way).xreplace(plant.numbers).tolist(), dtype=float)
    K_P = np.array([gains.values[f"K_P_{c}"] for c in plant.vehicle.pose_names])
    error, nu = -state[:n], state[n:]
    return float(0.5 * nu @ M @ nu + 0.5 * error @ (K_P * error))


def simulated(gains: GainSet, first: dict[str, Array], duration: float) -> Array:
    """Largest pose error at the end, of axes that are pushed, beside that of the start, by run."""
    loop = ClosedLoop(gains)
    n = len(gains.plant.vehicle.pose_names)
    zero = tuple(0.0 for _ in range(n))
    for dt in (0.01, 0.001):
        try:
            runs = loop.run_many(Scenario(zero, duration, dt), starts=first)
            break
        except UndertowError:
            if dt == 0.001:
                raise
    pose = runs.states[:, -1, :n]
    names = gains.plant.vehicle.pose_names
    turns = np.array([c in ("phi", "theta", "psi") for c in names])
    pose = np.where(turns, (pose + np.pi) % (2 * np.pi) - np.pi, pose)
    begun = np.array([first[c] for c in names]).T
    scale = np.array([np.abs(begun[:, turns == t]).max(axis=1) for t in turns]).T
    silent = {AXES[d][2] for d in gains.unactuated}
    kept = [i for i, c in enumerate(names) if c not in silent and not ({"x", "y"} & silent and c in "xy")]
    return np.nan_to_num(np.max(np.abs(pose / scale)[:, kept], axis=1), nan=np.inf)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--starts", type=int, default=16)
    parser.add_argument("--effects", action="store_true", help="add an effect that no condition knows")
    parser.add_argument(
        "--box", type=float, help="PID loops only, with a stated start box: share of a length"
    )
    parser.add_argument("--first", type=int, default=0, help="of --box the first case, to go on with --rows")
    parser.add_argument("--seconds", type=float, default=1e9, help="stop --box after this time")
    parser.add_argument(
        "--degrees",
        type=int,
        nargs="+",
        default=(1, 3, 4, 6),
        help="degrees of freedom of the loops of --box",
    )
    parser.add_argument("--stable", action="store_true", help="of --box only loops that are called stable")
    parser.add_argument("--page", type=Path, help="write the tables of --box as a page")
    parser.add_argument(
        "--rows", type=Path, help="keep loops of --box here, and take those of other runs into the page"
    )
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "certificates")
    wish = parser.parse_args()
    if wish.box:
        return boxes(wish)
    counts: dict[str, int] = {}
    for k in range(wish.cases):
        rng = np.random.default_rng((wish.seed, k))
        folder = wish.keep / f"{wish.seed}-{k}"
        folder.mkdir(parents=True, exist_ok=True)
        outcome = judge(draw(rng, wish.effects), folder, wish.starts, rng)
        counts[outcome.partition(":")[0]] = counts.get(outcome.partition(":")[0], 0) + 1
        if not outcome.startswith(("certified", "refused")) or "--" in outcome:
            print(f"{folder}: {outcome}", flush=True)
    print(counts)
    return 1 if "BROKEN" in counts else 0


def boxes(wish: argparse.Namespace) -> int:
    """PID loops with a stated start box: how many that are called stable are certified, in how long."""
    rows, begun = _kept(wish.rows), time.monotonic()
    cases = wish.first
    while cases < wish.cases and time.monotonic() - begun <= wish.seconds:
        rng = np.random.default_rng((wish.seed, cases))
        gains = _drawn(wish, cases, rng)
        if gains is not None:
            rows.append(_boxed(gains, wish, cases, rng))
            print(*rows[-1], flush=True)
            if wish.rows:
                with wish.rows.open("a") as kept:
                    kept.write(json.dumps(rows[-1]) + "\n")
        cases += 1
    page = page_of(rows, wish.box, cases)
    print(page)
    if wish.page:
        wish.page.write_text(page)
    return 1 if any(max(r.reached, r.reached_over) > 1 for r in rows) else 0


def _kept(rows: Path | None) -> list[Outcome]:
    """What earlier runs left."""
    if rows is None or not rows.exists():
        return []
    return [Outcome(*json.loads(line)) for line in rows.read_text().splitlines()]


def _drawn(wish: argparse.Namespace, number: int, rng: np.random.Generator) -> GainSet | None:
    """The PID loop of a case with thrusters in all axes, or None."""
    case, folder = draw(rng, False), wish.keep / f"{wish.seed}-{number}"
    if 'law = "pid"' not in case.gains:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    try:
        gains = load(case, folder)
    except UndertowError:
        return None
    return None if gains.unactuated or len(gains.plant.nu) not in wish.degrees else gains


class Outcome(NamedTuple):
    """What became of one loop with a stated start box."""

    seed: int
    case: int
    size: int  # degrees of freedom
    called: str  # by linearisation and simulation
    damping: float  # least damping ratio of the roots at rest
    said: str  # "certified", or why not; "not asked" where only loops called stable are asked for
    reached: float  # largest share of a claim that an attack came to: above one it is broken
    seconds: float
    # The same of a certificate over parameters within SPREAD of their values:
    said_over: str
    reached_over: float
    seconds_over: float


def _boxed(gains: GainSet, wish: argparse.Namespace, case: int, rng: np.random.Generator) -> Outcome:
    """What became of one loop."""
    box = box_of(gains, wish.box)
    roots = roots_of(gains)
    called = called_stable(gains, box, roots, rng)
    damping = min(-r.real / abs(r) for r in roots)
    each = [("not asked", 0.0, 0.0)] * 2
    if called == "stable" or not wish.stable:
        lasts = max(-12 / max(r.real for r in roots), 60.0)
        each = [_judged(gains, box, over, lasts, rng) for over in (None, SPREAD)]
    return Outcome(wish.seed, case, len(box), called, damping, *each[0], *each[1])


def _judged(
    gains: GainSet, box: dict[str, float], over: float | None, lasts: float, rng: np.random.Generator
) -> tuple[str, float, float]:
    """Whether a start box is certified, how far an attack comes, and the processor time, s.

    `lasts` is how long motions take to come to rest.
    """
    begun = time.process_time()
    report = certify(gains, forms=["derived"], start=box, uncertain=over)
    seconds = time.process_time() - begun
    reached = 0.0
    if report.ok and report.region.by_search:
        target = target_of(gains, report, min(lasts, ATTACKED), lasts <= ATTACKED, Attack())
        reached = target.worst(rng) if target else 0.0
    return _said(report), reached, seconds


def _said(report: Report) -> str:
    """The verdict, and in a few words why it is no."""
    if report.ok:
        return "certified"
    text = report.region.text
    for words, cause in CAUSES:
        if words in text:
            return cause
    return "conditions" if report.region.kind != "none" else "no proof"


PAGE = """# Certificates of PID loops

How many PID loops that are stable get a certificate from `undertow gains --start`, and whether attacks break one.
Written by `python -m benchmarks.certificates --cases {cases} --seed {seeds} --box {share:g} --stable --page docs/certificates.md`.

**Loops.** Random vehicles of some kilograms to some tons with inertia, added mass, Coriolis forces, linear and quadratic
damping, lift and buoyancy, a third of the coefficients different ahead and astern, a thruster in every axis, most of them
with limits; random gains of natural frequencies from 0.05 to 2 rad/s in each axis. A loop is *called stable* if every pole
at rest decays, and simulations of up to {longest:g} s from 16 corners of the start box at {headings} headings of the
set-point come back with no command at its limit. Only these are counted. Of {cases} cases, {pid} are PID loops with a thruster in every
axis: {called}.

**Certificate.** It says of the start box ({share:g} of the vehicle's length in every translation, {share:g} rad in every
angle, at rest, at any heading of the set-point) that every motion from it comes to rest at the set-point, and bounds errors, speeds and
commands on the way, these below their limits. It is a quadratic V or bounds in time, both proved in interval arithmetic
for the parameters of the file ([how](gains.md#a-quadratic-v)), and in a second certificate (`--uncertain {spread:.0%}`) for every value of all
parameters of inertia and damping within {spread:.0%} of those of the file ([how](gains.md#over-parameters)).

**Attack.** Against each certificate, a differential evolution ({tries} simulations of up to {attacked:g} s) looks for the start, the heading, the
limit of each thruster (from the certified bound on its command up to that of the file) and, for the second certificate, the value of each parameter
(within {spread:.0%}) that come closest to breaking a claim: an error, a speed or a command above its bound, V that rises, or a motion that does not
come to rest. What seems broken is attacked anew with a law that is not sampled, for which the claims are made.

With the parameters of the file:

| degrees of freedom | called stable | certified | share (95% interval) | broken by attacks | closest to a bound | processor seconds, median | longest |
|---|---|---|---|---|---|---|---|
{table}

With every value of the parameters within {spread:.0%}:

| degrees of freedom | called stable | certified | share (95% interval) | broken by attacks | closest to a bound | processor seconds, median | longest |
|---|---|---|---|---|---|---|---|
{over}

*Closest to a bound* is the largest share of any bound that attacks reached: one would break it. Intervals of shares are those of Clopper and Pearson.

## Claims that attacks broke

{broken}

## Loops without a certificate

| case | degrees of freedom | least damping ratio | with the parameters of the file | within {spread:.0%} |
|---|---|---|---|---|
{refused}

*A command meets its limit*: the bound on a command is above the limit of its thruster, although no simulation got there; saturation
itself is not part of any certificate. *No proof*: neither a V whose level set holds the start nor bounds in
time that close. The least damping ratio is that of the poles at rest, over all headings.
"""  # noqa: E501


def page_of(rows: list[Outcome], share: float, cases: int) -> str:
    """The tables of the counts of so many cases."""
    stable = [r for r in rows if r.called == "stable"]
    over = [r._replace(said=r.said_over, reached=r.reached_over, seconds=r.seconds_over) for r in stable]
    called = Counter(r.called for r in rows)
    return PAGE.format(
        share=share,
        cases=f"{cases}",
        seeds=", ".join(map(str, sorted({r.seed for r in rows}))),
        pid=len(rows),
        called=", ".join(f"{count} {what}" for what, count in called.most_common()),
        longest=LONGEST,
        attacked=ATTACKED,
        headings=Attack().headings,
        tries=Attack().generations * Attack().many,
        table=_table(stable),
        over=_table(over),
        spread=SPREAD,
        broken=_broken(stable),
        refused="\n".join(
            f"| {r.case} | {r.size} | {r.damping:.3f} | {r.said} | {r.said_over} |"
            for r in sorted(stable, key=lambda r: (r.size, r.case))
            if (r.said, r.said_over) != ("certified", "certified")
        ),
    )


def _broken(rows: list[Outcome]) -> str:
    """Every claim that an attack broke, in a line."""
    found = [
        f"- Case {r.case}, {r.size} degrees of freedom, {what}: {reached:.4f} of a bound."
        for r in rows
        for what, reached in (("parameters of the file", r.reached), ("over parameters", r.reached_over))
        if reached > 1
    ]
    return "\n".join(found) or "None."


def _table(rows: list[Outcome]) -> str:
    """A row for each number of degrees of freedom, and one for all of them."""
    sizes = sorted({r.size for r in rows})
    parts = [(str(size), [r for r in rows if r.size == size]) for size in sizes]
    return "\n".join(_counted(*part) for part in [*parts, ("all", rows)])


def _counted(name: str, rows: list[Outcome]) -> str:
    """One row of the table."""
    yes, many, times = sum(r.said == "certified" for r in rows), len(rows), [r.seconds for r in rows]
    low, high = (float(np.nan_to_num(beta.ppf(p, yes + side, many - yes + 1 - side), nan=1.0 - p))
                 for p, side in ((0.025, 0), (0.975, 1)))  # fmt: skip
    low, high = low if yes else 0.0, high if yes < many else 1.0
    broken, closest = sum(r.reached > 1 for r in rows), np.floor(1e4 * max(r.reached for r in rows)) / 1e4
    return (
        f"| {name} | {many} | {yes} | {yes / many:.0%} ({low:.0%} to {high:.0%}) | {broken} "
        f"| {closest:.4f} | {np.median(times):.1f} | {max(times):.1f} |"
    )


def judge(case: Case, folder: Path, count: int, rng: np.random.Generator) -> str:
    """What became of a case, in words."""
    try:
        gains = load(case, folder)
        report = certify(gains, Uncertainty(gains.plant.vehicle), forms=["derived"])
    except UndertowError as error:
        return f"bad input: {error}"
    law = gains.law.id
    if not report.ok:
        return f"refused {law} {_why(report)}"
    slowest = min((-c.roots[0].real for c in report.channels), default=0.05)
    if law not in ("pd", "pid"):
        slowest = min(v for n, v in gains.values.items() if n.startswith("Lambda") and v)
    duration = max(25 / max(slowest, 1e-9), 60.0)
    if duration > 2500:
        return f"certified, too slow to simulate {law}"
    try:
        left = simulated(gains, starts(gains, report, count, rng), duration)
    except UndertowError as error:
        return f"not simulated: {error}"
    if left.max() > 0.3:
        where = f"{report.region.kind} {report.region.level}"
        return f"BROKEN: {law} {where} {left.max():.3g} of the start's error after {duration:.0f} s"
    return f"certified and comes {law}"


def _why(report: Report) -> str:
    if not report.conditions_hold:
        return "conditions"
    if report.zero_dynamics and not report.zero_dynamics.stable:
        return "left alone"
    if report.region.kind == "none" and not report.zero_dynamics:
        return "region"
    return f"whole loop {report.full_loop.verdict if report.full_loop else ''}"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    raise SystemExit(main())
