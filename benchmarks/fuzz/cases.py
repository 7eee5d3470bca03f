"""A damaged file and what is done with it, all of it out of a seed and a number."""

from __future__ import annotations

import random
from dataclasses import dataclass

from undertow.model.loading import bundled_vehicles

from .mutations import BYTES, OF_TABLES, OF_TEXT, Mutation, mutated
from .originals import MAPPING, originals, surface_log, surface_vehicle

#: How often each kind of file is taken, by the readers that are for it.
SHARES = {
    "vehicle": 30, "gains": 20, "mapping": 15, "log": 20, "parts of a log": 4, "diagnosis": 2,
    "diagnosis for a plan": 1, "snapshot": 1, "manifest": 1, "STL": 2, "OBJ": 2, "MSH": 1, "partition": 1,
    "store": 1,
}  # fmt: skip
_COMMANDS_SHARE = 0.3
_DESIGN = "design {} --error x=0.5,y=0.5,psi=0.2 --force surge=1,sway=1,yaw=0.5 --out out.toml"
_SIMULATE = "simulate mini-auv {} --to 1,0,1 --for 3 --dt 0.01 --out out.csv --json out.json"
_VEHICLE_COMMANDS = (
    "vehicles show {}",
    "audit {}",
    "export c {} --out out",
    "linearize {}",
    "update {} --out out",
    "added-mass box --length 1 --beam 1 --height 1 --into {} --out out.toml",
)
_PAPER_COMMANDS = (
    "gains {} paper-pd --json",
    "gains {} paper-smc",
    "simulate {} paper-pid --to 1,0,1 --for 3 --dt 0.01 --out out.csv",
    "simulate {} paper-pd --to 1,0,1 --for 2 --dt 0.01 --json out.json",
)
_SURFACE_COMMANDS = (
    "compare {} log.csv",
    "fit {} log.csv --out out.toml",
    "fit {} log.csv --method output-error --horizon 2 --out out.toml",
    "doctor {} log.csv --json out.json",
    "add ocean_current {} log.csv --force --no-codegen --out out.toml",
    "plan {} log.csv --tries 20 --duration 10 --out out.csv --json out.json",
    _DESIGN,
)
_GAINS_COMMANDS = (
    "gains mini-auv {} --json",
    "gains mini-auv {}",
    _SIMULATE,
    "linearize mini-auv --gains {}",
    "export c mini-auv --controller {} --out out",
)
_MAPPING_COMMANDS = (
    "doctor vehicle.toml log.csv --map {} --mend out.toml --json out.json",
    "compare vehicle.toml log.csv --map {}",
    "fit vehicle.toml log.csv --map {} --out out.toml",
)
_LOG_COMMANDS = (
    "doctor vehicle.toml {} --json out.json",
    "compare vehicle.toml {}",
    "fit vehicle.toml {} --out out.toml",
    "fit vehicle.toml {} --method instrumental --horizon 1 --fill hold",
    "plan vehicle.toml {} --tries 20 --duration 10 --out out.csv",
    "doctor vehicle.toml {} --map mapping.toml --mend out.toml",
    "compare vehicle.toml {} --map mapping.toml --from 2 --to 18",
)
#: Commands for each kind of file.
COMMANDS = {
    "vehicle": (*_VEHICLE_COMMANDS, *_PAPER_COMMANDS, *_SURFACE_COMMANDS),
    "gains": _GAINS_COMMANDS,
    "mapping": _MAPPING_COMMANDS,
    "log": _LOG_COMMANDS,
}
_SUFFIXES = {"vehicle": "toml", "gains": "toml", "mapping": "toml", "log": "csv"}


@dataclass(frozen=True)
class Case:
    """One file that is damaged.

    Attributes
    ----------
    name : str
        Seed and number, by which it can be made again.
    reader : str
        Which reader it is for.
    content : bytes
        The file.
    command : str
        Words of a command with {} for the file; empty where the reader alone is asked.
    """

    name: str
    reader: str
    content: bytes
    command: str = ""

    @property
    def file(self) -> str:
        """What the damaged file is called where a command reads it."""
        return f"damaged.{_SUFFIXES[self.reader]}"

    @property
    def beside(self) -> dict[str, bytes]:
        """Sound files that commands need beside it."""
        return {"vehicle.toml": surface_vehicle(), "log.csv": surface_log(), "mapping.toml": MAPPING}


def case(seed: int, number: int) -> Case:
    """The case of a seed and a number; always the same one."""
    rng = random.Random(f"{seed}:{number}")
    reader = rng.choices([*SHARES], [*SHARES.values()])[0]
    commands = COMMANDS.get(reader, ())
    command = rng.choice(commands) if commands and rng.random() < _COMMANDS_SHARE else ""
    sound = rng.choice(sound_files(reader, command))
    return Case(f"{seed}:{number}", reader, mutated(sound, rng, damage_to(reader)), command)


def sound_files(reader: str, command: str) -> tuple[bytes, ...]:
    """Files that a reader, or a command of that reader, has an answer for."""
    if command in _PAPER_COMMANDS:
        return (bundled_vehicles()["mini-auv"].read_bytes(),)
    if command in _SURFACE_COMMANDS:
        return (surface_vehicle(),)
    own = {"log": surface_log(), "mapping": MAPPING}
    return (own[reader],) if command and reader in own else originals()[reader]


def damage_to(reader: str) -> tuple[Mutation, ...]:
    """Mutations that suit what a reader reads."""
    if reader in ("log", "parts of a log", "partition"):
        return OF_TABLES
    return BYTES if reader == "store" else OF_TEXT
