"""The logs that are shipped inside the package for `undertow demo`."""

from __future__ import annotations

from pathlib import Path

from .cases import Case, make_case
from .files import write_case, write_log

#: Where the package keeps them.
DEMO_DATA = Path(__file__).parents[2] / "src" / "undertow" / "demo_data"
#: What the AUV of the demo was made with.
VEHICLE, EFFECTS, SEED, DURATION = "mini-auv", ("ocean_current",), 10, 60.0
CFD_LOGS = ("surge_step_medium", "surge_step_coarse", "surge_multistep_coarse")

README = """# auv: simulated logs with one hidden effect

Made by `python -m benchmarks.hidden_effects demo` in the repository (plain NumPy, not undertow's own model):
a mini-AUV with four degrees of freedom, {duration:.0f} s at 20 Hz, seed {seed}. The same command gives
the same numbers.

- `train_1` random steps, `train_2` cruise with turns, `train_3` multi-sine, `holdout` other random steps.
- Columns: t s; x y z m (NED); phi theta psi rad; u v w m/s over ground in body axes; p q r rad/s; f1 to f4
  commands in N, held between samples.
- White noise, standard deviations: x y 0.02 m, z 0.005 m, psi 0.003 rad, u v w 0.01 m/s, r 0.002 rad/s.
  phi, theta, p and q are 0: this vehicle does not roll or pitch.
- `vehicle.toml` is what a user would believe beforehand; `truth.json` says what is hidden, with its values.
"""


def demo_case() -> Case:
    """The demo's AUV case."""
    return make_case(VEHICLE, EFFECTS, SEED, duration=DURATION)


def write_demo(folder: Path = DEMO_DATA) -> Path:
    """Write the AUV logs, their README, the vehicle and the truth into folder/auv."""
    target = write_case(demo_case(), folder / "auv", compress=True)
    readme = README.format(duration=DURATION, seed=SEED)
    (target / "README.md").write_text(readme, encoding="utf-8", newline="\n")
    return target


def write_cfd(source: Path, folder: Path = DEMO_DATA) -> Path:
    """Copy the CFD surge logs that the demo shows, compressed, and their README into folder/cfd-surge."""
    target = folder / "cfd-surge"
    target.mkdir(parents=True, exist_ok=True)
    for name in CFD_LOGS:
        text = (source / f"{name}.csv").read_text(encoding="utf-8")
        write_log(target / f"{name}.csv", text, compress=True)
    (target / "README.md").write_bytes((source / "README.md").read_bytes())
    return target
