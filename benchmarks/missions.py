"""Pictures of docs/missions.md: ``python -m benchmarks.missions`` draws them and prints what came out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from undertow.control.closed_loop import Overrides, Record, Scenario
from undertow.control.guidance.mission import load_mission
from undertow.figures import COLOURS, INK, figure, look, save_png
from undertow.model.loading import load_vehicle

ROOT = Path(__file__).parents[1]
FILES = ROOT / "examples" / "missions"
RUNS = {
    "bluerov2": ("bluerov2-gains.toml", "bluerov2-spline.toml", 0.02, {}, None),
    "remus100": ("remus100-gains.toml", "remus100-survey.toml", 0.05, {"u": 1.5}, None),
    "remus100-los": ("remus100-gains.toml", "remus100-survey.toml", 0.05, {"u": 1.5}, 0.0),
}


def run(name: str) -> Record:
    """One of the runs, with another integral action where one is named."""
    from dataclasses import replace

    gains, path, dt, moving, integral = RUNS[name]
    mission = load_mission(FILES / path)
    if integral is not None:
        mission = replace(mission, guidance=replace(mission.guidance, integral=integral))
    vehicle = load_vehicle(name.split("-")[0])
    loop = Overrides().loop(FILES / gains, vehicle, mission=mission)
    return loop.run(Scenario(duration=mission.simulation_time(vehicle.pose_names), dt=dt, moving=moving))


def tracks(records: dict[str, Record], title: str) -> Figure:
    """The way in the plane up to the end of the mission."""
    with look():
        picture, axes = figure(4.8)
        axis = axes[0, 0]
        for i, (label, record) in enumerate(records.items()):
            assert record.followed is not None
            own = _until(record)
            if not i:
                axis.plot(
                    record.followed.path[:, 0], record.followed.path[:, 1], ":", color=INK, label="mission"
                )
            axis.plot(record.state["x"][own], record.state["y"][own], label=label, color=COLOURS[i])
            if record.estimated:
                seen = record.estimated["x"][own], record.estimated["y"][own]
                axis.plot(*seen, "--", label="estimated", color=COLOURS[i + 1])
        axis.set(xlabel="north x [m]", ylabel="east y [m]", aspect="equal", title=title)
        axis.grid()
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return picture


def errors(
    records: dict[str, Record], name: str, scale: float, unit: str, fins: tuple[str, ...] = ()
) -> Figure:
    """An error along the mission, and the commands of the first run, those of fins in degrees apart."""
    first = next(iter(records.values()))
    groups = {"thrust [N]": [n for n in first.commands if n not in fins], "fins [deg]": list(fins)}
    groups = {label: names for label, names in groups.items() if names}
    with look():
        picture, axes = figure(2.6 * (1 + len(groups)), 1 + len(groups), 1, sharex=True)
        for i, (label, record) in enumerate(records.items()):
            assert record.followed is not None
            own = _until(record)
            axes[0, 0].plot(
                record.t[own], scale * record.followed.errors[name][own], label=label, color=COLOURS[i]
            )
        axes[0, 0].set_ylabel(f"{name} [{unit}]")
        for axis, (label, names) in zip(axes[1:, 0], groups.items(), strict=True):
            _commands(axis, first, names, 180 / np.pi if "deg" in label else 1.0)
            axis.set_ylabel(label)
        axes[-1, 0].set_xlabel("time [s]")
        for axis in axes[:, 0]:
            axis.grid()
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return picture


def _commands(axis: Any, record: Record, names: list[str], scale: float) -> None:
    own = np.flatnonzero(_until(record))[:-1]  # the last one is after the end
    for i, name in enumerate(names):
        style = "-" if i < len(COLOURS) else "--"
        axis.plot(
            record.t[own],
            scale * record.commands[name][own],
            style,
            label=name,
            color=COLOURS[i % len(COLOURS)],
        )


def _until(record: Record) -> Any:
    followed = record.result.followed
    assert followed is not None
    return record.t <= (followed.arrived or np.inf)


def main(folder: Path = ROOT / "docs" / "images") -> None:
    """Run, print and draw."""
    found = {name: run(name) for name in RUNS}
    for name, record in found.items():
        print(name, record.result.followed)
    torpedo = {"ILOS": found["remus100"], "LOS": found["remus100-los"]}
    rov = {"bluerov2": found["bluerov2"]}
    save_png(tracks(rov, "BlueROV2 on a spline"), folder / "missions-bluerov2-track.png")
    save_png(errors(rov, "x", 1e3, "mm"), folder / "missions-bluerov2-errors.png")
    save_png(
        tracks(torpedo, "REMUS 100 on legs, current 0.3 m/s to the east"),
        folder / "missions-remus100-track.png",
    )
    save_png(
        errors(torpedo, "cross track", 1.0, "m", ("rudder", "stern_plane")),
        folder / "missions-remus100-errors.png",
    )


if __name__ == "__main__":
    main()
