"""List the bundled vehicles, or show one vehicle file.

Without a subcommand, it lists the bundled vehicles. `show` prints effects and parameters of a vehicle in the
sign convention of its file, with units and sources, and what is missing or assumed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from .._options import EffectsOption, JsonOption, VehicleArgument
from .._terminal import console, print_json, section, table, text

if TYPE_CHECKING:
    from undertow.model.vehicle import Vehicle

app = typer.Typer(add_completion=False)


@app.callback(invoke_without_command=True)
def vehicles(context: typer.Context, json: JsonOption = False) -> None:
    if context.invoked_subcommand is not None:
        return
    from undertow.model.loading import bundled_vehicles

    found = [_summary(path) for path in bundled_vehicles().values()]
    if json:
        print_json(found)
    else:
        rows = ((v["name"], " ".join(v["degrees_of_freedom"]), v["description"]) for v in found)
        console().print(table(("name", "degrees of freedom", "what it is"), rows, indent=0))


@app.command()
def show(vehicle: VehicleArgument, json: JsonOption = False, effects: EffectsOption = None) -> None:
    """Show effects and parameters of a vehicle with their sources, and what is missing or assumed."""
    from undertow.model.loading import load_vehicle, resolve_vehicle
    from undertow.model.plausibility import hints

    loaded = load_vehicle(vehicle, effect_files=effects or [])
    content = _summary(resolve_vehicle(vehicle)) | _content(loaded) | {"hints": hints(loaded)}
    if json:
        print_json(content)
    else:
        _print_vehicle(content)


def _summary(path: Path) -> dict[str, Any]:
    from undertow.model.loading import read_vehicle_table

    read = read_vehicle_table(path)
    keys = ("name", "description", "source", "degrees_of_freedom", "signs")
    return {key: getattr(read, key) for key in keys}


# --- what is in a vehicle -------------------------------------------------------------------------
def _content(vehicle: Vehicle) -> dict[str, Any]:
    own = {e.id for e in vehicle.effects}
    stated = [(e.id, list(_parameters(vehicle, e))) for e in vehicle.all_effects]
    return {
        "effects": [{"id": i, "parameters": rows} for i, rows in stated if rows or i in own],
        "thrusters": [
            {
                "name": t.name,
                "wrench": list(t.wrench),
                "thrust_per_command": t.thrust_per_command.value,
                "limit": t.limit,
                "lowest": t.lowest,
            }
            for t in vehicle.thrusters
        ],
        "surfaces": [
            {"name": s.name, "position": list(s.position), "axis": list(s.axis), "area": s.area}
            for s in vehicle.surfaces
        ],
        "inputs": dict(vehicle.inputs),
        "generalised_forces": list(vehicle.force_channels),
        "environment": dict(vehicle.environment),
    }


def _parameters(vehicle: Vehicle, effect: Any) -> Iterator[dict[str, Any]]:
    from undertow.model.parameter import printed
    from undertow.model.units import short_unit

    for p in effect.parameters:
        for way, value in vehicle.values_of(p).items():
            yield {
                "name": p.name if way == "value" else f"{p.name}_{way}",
                "value": printed(p, value.value, vehicle.signs),
                "unit": short_unit(p.unit),
                "sigma": value.sigma,
                "estimate": value.estimate,
                "assumed": value.assumed,
                "source": value.source,
            }


# --- printing -------------------------------------------------------------------------------------
def _print_vehicle(v: dict[str, Any]) -> None:
    out = console()
    out.print(text(v["name"], "bold"))
    signs = {"sname": "SNAME signs", "magnitudes": "positive magnitudes"}[v["signs"]]
    water = "water {rho:g} kg/m^3, gravity {g:g} m/s^2".format(**v["environment"])
    for line in (v["description"], v["source"], f"{' '.join(v['degrees_of_freedom'])}; {signs}; {water}"):
        if line:
            out.print(text(line))
    for effect in v["effects"]:
        rows = [_parameter_row(p) for p in effect["parameters"]]
        section(effect["id"], table(("", "", "", "", ""), rows) if rows else None)
    if v["thrusters"]:
        section("thrusters", table(("name", *"XYZKMN", "N per command"), map(_thruster_row, v["thrusters"])))
    if v["surfaces"]:
        section("surfaces", table(("name", *"xyz", "axis", "area, m^2"), map(_surface_row, v["surfaces"])))
    if v["inputs"]:
        names = " ".join(f"{n} ({unit})" for n, unit in v["inputs"].items())
        section("taken from the log", text(f"  {names}"))
    if v["generalised_forces"]:
        section("forces known from the log", text(f"  {' '.join(v['generalised_forces'])}"))
    if v["hints"]:
        section("left open", table(("",), ((hint,) for hint in v["hints"])))


def _parameter_row(p: dict[str, Any]) -> tuple[Any, ...]:
    unit = "" if p["unit"] == "1" else f" {p['unit']}"
    sigma = "" if p["sigma"] is None else f"± {p['sigma']:.3g}"
    role = text("assumed", "yellow") if p["assumed"] else "estimate" if p["estimate"] else "known"
    return p["name"], f"{p['value']:.10g}{unit}", sigma, role, p["source"]


def _thruster_row(t: dict[str, Any]) -> tuple[str, ...]:
    # + 0.0 turns -0.0 into 0.0
    return t["name"], *(f"{w + 0.0:.4g}" for w in t["wrench"]), f"{t['thrust_per_command']:.4g}"


def _surface_row(s: dict[str, Any]) -> tuple[str, ...]:
    axis = " ".join(f"{a + 0.0:.3g}" for a in s["axis"])
    return s["name"], *(f"{p + 0.0:.4g}" for p in s["position"]), axis, f"{s['area']:.4g}"
