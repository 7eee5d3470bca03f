"""The simulator's true values under the names of the catalogue."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import pi

from undertow.model.parameter import Parameter

#: Names of the catalogue for values that the simulator calls otherwise.
SAME: dict[str, tuple[str, ...]] = {
    "width": ("deadband_width",),
    "limit": ("saturation_limit",),
    "T": ("T_lag",),
    "T_m": ("T_memory",),
    "delay": ("delay", "velocity_delay"),
    "s": ("scale_velocity",),
    "alpha": ("turn_z",),
    "direction": ("wave_direction",),
    "L_0": ("L_slack",),
    "L": ("L_cross",),
    "x_0": ("x_cross",),
    "x_a": ("x_tail", "x_eye"),
    "y_a": ("y_tail", "y_eye"),
    "z_a": ("z_tail", "z_eye"),
}


def true_values(parameters: Iterable[Parameter], values: Mapping[str, float]) -> dict[str, float]:
    """What is known of an effect's parameters; the rest the refit has to find."""
    known = {new: value for name, value in values.items() for new in (name, *SAME.get(name, ()))}
    known |= _converted(values)
    # A linear parameter is found from anywhere, and may be scaled otherwise here.
    return {p.name: known[p.name] for p in parameters if p.name in known and not p.linear}


def _converted(values: Mapping[str, float]) -> dict[str, float]:
    """What the catalogue states by other numbers."""
    known: dict[str, float] = {}
    if "period" in values:
        known["wave_frequency"] = 2 * pi / values["period"]
    if "winch_z" in values:  # counted from the attachment of a level vehicle that heads north
        known |= {f"{axis}_anchor": -values[f"{axis}_a"] for axis in "xyz"}
        known["z_anchor"] += values["winch_z"]
    for name, part in (("z_w", "D"), ("y_w", "E")):
        if name in values:
            known |= {"fade_N": 0.0, "fade_E": 0.0, "fade_D": 0.0, "fade_0": values[name] / values["L"]}
            known[f"fade_{part}"] = 1.0 / values["L"]
    return known
