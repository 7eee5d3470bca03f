"""Vehicle files from a `vehicles.json` of another hidden-effect data set."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .belief import estimated
from .drawing import COLUMNS, MOTIONS
from .files import toml_text
from .world import skew


def convert_vehicles(source: str | Path, folder: str | Path) -> list[Path]:
    """Write one vehicle TOML per vehicle of a `vehicles.json`; returns the files."""
    folder, entries = Path(folder), json.loads(Path(source).read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, entry in entries.items():
        path = folder / f"{name}.toml"
        path.write_text(toml_text(converted(name, entry)), encoding="utf-8", newline="\n")
        written.append(path)
    return written


def converted(name: str, entry: dict[str, Any]) -> dict[str, Any]:
    """One entry of `vehicles.json` as a vehicle dictionary."""
    motions = [MOTIONS[COLUMNS.index(column)] for column in entry["degrees_of_freedom"]]
    effects = {"rigid_body": _rigid_body(entry["rigid_body"], motions), "rigid_body_coriolis": {}}
    effects["added_mass"] = _guesses(entry["added_mass"])
    effects["added_mass_coriolis"] = {}
    effects |= {
        name: _guesses(entry[name]) for name in ("linear_damping", "quadratic_damping") if entry.get(name)
    }
    if {"heave", "roll", "pitch"} & set(motions):
        effects["restoring"] = _restoring(entry["restoring"])
    return {
        "schema": "undertow/vehicle/1",
        "name": name,
        "degrees_of_freedom": motions,
        "signs": entry["signs"],
        "effects": effects,
        "thrusters": _thrusters(entry["allocation"], entry["command_limit_N"]),
    }


def _rigid_body(body: dict[str, Any], motions: list[str]) -> dict[str, float]:
    """Mass, centre of gravity, and moments of inertia moved from the centre of gravity to the origin.

    I_o = I_g - m S(r_g)^2 (parallel axes). That `I` is about the centre of gravity is not written in the data
    set; its case without hidden effect shows it: total inertia in roll and pitch comes out as 0.35 kg m^2,
    which is I + m z_g^2 + added mass, not as the 0.27 kg m^2 of I + added mass.
    """
    arm = skew(np.array(body["r_G"]))
    inertia = np.array(body["I"]) - body["m"] * arm @ arm
    table = {"m": body["m"]} | _centre("g", body["r_G"])
    for i, motion in enumerate(MOTIONS[3:]):
        if motion in motions:
            table[f"I_{'xyz'[i]}"] = round(float(inertia[i, i]), 9)
    if not {"roll", "pitch"} & set(motions):
        del table["z_g"]  # without roll and pitch the height of the centre of gravity shows nowhere
    return table


def _centre(which: str, place: list[float]) -> dict[str, float]:
    return {f"{axis}_{which}": float(value) for axis, value in zip("xyz", place, strict=True)}


def _restoring(entry: dict[str, Any]) -> dict[str, float]:
    return {"W": entry["weight_N"], "B": entry["buoyancy_N"]} | _centre("b", entry["r_B"])


def _guesses(values: dict[str, float]) -> dict[str, Any]:
    return {name: estimated(value) for name, value in values.items()}


def _thrusters(allocation: dict[str, Any], limit: float) -> list[dict[str, Any]]:
    columns = np.array(allocation["matrix"]).T + 0.0
    rotors = zip(allocation["columns"], columns.tolist(), strict=True)
    return [{"name": name, "wrench": column, "limit": limit} for name, column in rotors]
