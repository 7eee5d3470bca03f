"""The real logs, each with its vehicle file, its horizons, and what can be taken out of it or put into it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path

from benchmarks.examples import cfd, cse1, kvlcc2, sf30k
from benchmarks.examples.calls import Judged
from benchmarks.examples.variants import logs_of, vehicle_of
from undertow.identification.api import diagnose
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

#: Injections into the model ship's logs, which hold a pose and commands. Thrust per command is estimated
#: there, so that a wrong gain is nothing that a log could show.
_POSE_AND_COMMANDS = (
    "current", "compass", "antenna", "dead-band", "command-delay", "asymmetry", "curve", "droop", "mass",
    "centre",
)  # fmt: skip
#: Into a log with a velocity sensor as well, at uneven times.
_VELOCITY_SENSOR = (
    "current", "water-log", "compass", "antenna", "lever-arm", "misalignment", "bias", "gyro", "scale",
)  # fmt: skip
_SHIP_TERMS = ("rigid_body_coriolis", "added_mass", "linear_damping", "quadratic_damping")
#: The zigzags with which the model of the tanker is fitted, and those that it is judged by.
TANKER = ("Z_20_10_S.csv", "Z_10_10_P.csv", "Z_15_05.csv", "Z_30_05.csv"), ("Z_20_10_P.csv", "Z_25_05.csv")

#: Free runs of the ship in a pond: steered by hand at random, zigzags and a turn; the same of other days.
ESSO = (
    (
        "random/random_31-Jul-2020_12_48_39.csv",
        "zigzag/zigzag_31-Jul-2020_13_42_53.csv",
        "zigzag/zigzag_31-Jul-2020_14_03_39.csv",
        "turning/turn_14-Oct-2020_14_29_49.csv",
    ),
    (
        "random/random_31-Jul-2020_14_52_18.csv",
        "zigzag/zigzag_31-Jul-2020_13_50_28.csv",
        "zigzag/zigzag_31-Jul-2020_13_57_45.csv",
    ),
)


@dataclass(frozen=True)
class LogSet:
    """Logs to fit to and to judge by, with the sizes by which injections are measured.

    what: vehicle, mapping, logs and window.
    folder: where the logs are; relative to the folder of the data.
    horizons: lengths of the simulated windows, s: a fraction, about one and a multiple of the slowest time
        constant, the longest as long as the stretches without gaps allow.
    scales: sizes of 1: speed (m/s), turning rate (rad/s), length (m), command (its unit), duration (s), time
        (s, of delays).
    injections, removals: names of what is injected, and ids of the effects that are taken out.
    also: of a removal, what is right beside it, since the vehicle is known to have it and its file does not,
        or since it is the very same equation for this vehicle.
    documented: what the source of the logs says of the vehicle or its sensors, and the vehicle file lacks.
    """

    what: Judged
    folder: str
    horizons: tuple[float, float, float]
    scales: Mapping[str, float] = field(default_factory=dict)
    injections: tuple[str, ...] = ()
    removals: tuple[str, ...] = ()
    also: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    documented: tuple[str, ...] = ()

    def read(self, data: Path) -> tuple[Vehicle, list[Run], list[Run]]:
        """The vehicle as stated, the logs to fit to, and those to judge by (none: stretches are)."""
        vehicle = vehicle_of(self.what.vehicle)
        train, test = (logs_of(self.what, data / self.folder, vehicle, held=held) for held in (False, True))
        return vehicle, train, test


class Improved(LogSet):
    """A log set whose vehicle file has the effects that are found to improve predictions of its logs."""

    def read(self, data: Path) -> tuple[Vehicle, list[Run], list[Run]]:
        """The vehicle with these effects, as they are fitted; the logs as they are."""
        _, train, test = LogSet.read(self, data)
        return _improved(self.what, self.folder, data), train, test


def improved(logs: LogSet) -> LogSet:
    """The log set with what was found already in its vehicle file."""
    return Improved(**{f.name: getattr(logs, f.name) for f in fields(logs)})


@cache
def _improved(what: Judged, folder: str, data: Path) -> Vehicle:
    found = diagnose(*LogSet(what, folder, (1.0, 1.0, 1.0)).read(data))
    return found.helped or found.after


_CSE1 = {"speed": 0.2, "rate": 0.15, "length": 1.1, "command": 0.4, "duration": 700.0, "time": 1.0}
_SF30K = {"speed": 0.3, "rate": 0.1, "length": 2.4, "command": 300.0, "duration": 1330.0}
_BOX = {"speed": 0.2, "length": 0.6, "time": 0.5}
_ROLL = {"length": 4.7}
_TANKER = {"speed": 1.1, "rate": 0.05, "length": 7.0, "command": 0.35, "time": 1.0}
_SURGE = ("current", "water-log", "bias", "scale", "sensor-delay", "mass")
_SURGE_TERMS = ("added_mass", "linear_damping", "quadratic_damping")
_ROLL_CHANGES = ("inclinometer", "righting-arm")
_ROLL_TERMS = ("linear_damping", "restoring")
#: This ship has linear and quadratic damping in roll (docs/examples/kvlcc2.md); its file has the linear part.
_ROLL_ALSO = {"linear_damping": ("quadratic_damping",)}


#: In surge alone water in the hull is the same inertia as added mass.
_SURGE_ALSO = {"added_mass": ("entrained_water",)}


#: What is lost with the Coriolis forces of the added mass is surge force per v r, which is X_vr; what they do
#: in sway and yaw is in this file's lift.
_TANKER_ALSO = dict.fromkeys(("added_mass", "added_mass_coriolis"), ("manoeuvring_drag",))


def _ship(way: int, horizons: tuple[float, float, float] = (5.0, 30.0, 60.0)) -> LogSet:
    return LogSet(cse1.WAYS[way], cse1.FOLDER, horizons)


def _roll(way: Judged) -> LogSet:
    return LogSet(way, kvlcc2.FOLDER, (5.0, 20.0, 40.0), also=_ROLL_ALSO)


def _box(way: int) -> LogSet:
    return LogSet(cfd.WAYS[way], cfd.FOLDER, (1.0, 5.0, 18.0), also=_SURGE_ALSO)


def _rov(way: int) -> LogSet:
    # Its Doppler log is 0.54 m ahead of the origin and 0.56 m to port of it.
    return LogSet(sf30k.WAYS[way], sf30k.FOLDER, (5.0, 30.0, 60.0), documented=("velocity_lever_arm",))


#: Logs by the name that cases have; those with neither injections nor removals are diagnosed as they are.
SETS: dict[str, LogSet] = {
    "cse1-joystick": replace(_ship(0), scales=_CSE1, injections=_POSE_AND_COMMANDS, removals=_SHIP_TERMS),
    "cse1-joystick-back": _ship(1),
    "cse1-slow": _ship(2),
    "cse1-slow-back": _ship(3),
    "cse1-positioning": replace(_ship(4), scales=_CSE1 | {"speed": 0.1}, injections=_POSE_AND_COMMANDS),
    "cse1-positioning-back": _ship(5),
    "cse1-mixed": _ship(6),
    "cse1-mixed-back": _ship(7),
    "cse1-waves": _ship(8),
    "cse1-waves-back": _ship(9),
    "sf30k-6": replace(_rov(0), scales=_SF30K, injections=("righting-arm", "buoyancy", "current", "compass")),
    "sf30k-4": replace(
        _rov(1),
        scales=_SF30K,
        injections=(
            *_VELOCITY_SENSOR,
            "gain",
            "dead-band",
            "asymmetry",
            "curve",
            "droop",
            "mass",
            "buoyancy",
        ),
    ),
    "roll-38-37": replace(
        _roll(kvlcc2.WAYS[0]), scales=_ROLL, injections=_ROLL_CHANGES, removals=_ROLL_TERMS
    ),
    "roll-37-38": replace(
        _roll(kvlcc2.WAYS[1]), scales=_ROLL, injections=_ROLL_CHANGES, removals=_ROLL_TERMS
    ),
    "roll-under-way": _roll(kvlcc2.SPEED_WAYS[0]),
    "box-step": replace(_box(0), scales=_BOX, injections=_SURGE, removals=_SURGE_TERMS),
    "box-multistep": replace(_box(1), scales=_BOX, injections=_SURGE, removals=_SURGE_TERMS),
    "box-fine": _box(2),
}


def tanker(folder: Path) -> LogSet:
    """The zigzags of a 7 m tanker (HSVA), which nobody may hand on: from a folder of one's own."""
    ship, columns = (str((folder / name).resolve()) for name in ("vehicle.toml", "log.toml"))
    train, test = TANKER
    return LogSet(
        Judged("KVLCC2 zigzags", ship, columns, train, test),
        str(folder.resolve()),
        (5.0, 30.0, 60.0),
        _TANKER,
        (*_VELOCITY_SENSOR, "sensor-delay", "dead-band", "command-delay", "asymmetry", "mass", "centre"),
        (
            "lift", "crossflow_drag", "rudder_force", "quadratic_damping", "rigid_body_coriolis",
            "added_mass", "added_mass_coriolis",
        ),
        _TANKER_ALSO,
    )  # fmt: skip


def pond(folder: Path) -> LogSet:
    """Free runs of a 3 m ship in a pond, with the wind as it was measured aboard."""
    ship, columns = (str(Path(__file__).parent / "esso" / name) for name in ("vehicle.toml", "log.toml"))
    train, test = ESSO
    return LogSet(
        Judged("Esso Osaka, wind measured", ship, columns, train, test),
        str(folder.resolve()),
        (15.0, 60.0, 100.0),
        {"speed": 0.17, "rate": 0.024, "length": 3.0, "command": 0.35, "time": 1.0},
        ("current", "compass", "lever-arm", "misalignment", "bias", "scale", "sensor-delay", "mass"),
        ("lift", "crossflow_drag", "quadratic_damping", "added_mass"),
    )


def log_sets(zigzags: Path | None, free_runs: Path | None = None) -> dict[str, LogSet]:
    """All sets, with those of the tanker and of the ship in a pond where their folders are given."""
    more = {"tanker": (tanker, zigzags), "esso": (pond, free_runs)}
    return SETS | {name: made(folder) for name, (made, folder) in more.items() if folder is not None}
