"""Command line: python -m benchmarks.hidden_effects --help"""

from __future__ import annotations

import argparse
import sys
import textwrap
from pathlib import Path

from .cases import make_case
from .conversion import convert_vehicles
from .demo import DEMO_DATA, write_cfd, write_demo
from .files import write_case
from .registry import EFFECTS
from .simulation import RUNS
from .vehicles import NOMINAL

PROGRAM = "python -m benchmarks.hidden_effects"
INTRODUCTION = """\
Simulate a marine vehicle that has something its model does not have, and write what a user would get: logs
(CSV), the model as believed beforehand (vehicle.toml) and, for the judge, what is hidden (truth.json)."""

EXAMPLES = """\
examples:
  # bilinear lift that the ROV's model lacks; four runs of 100 s in cases/lift
  python -m benchmarks.hidden_effects --out cases/lift --vehicle rov --effect lift --seed 3
  # nothing hidden, but one damping guess is 2 times off
  python -m benchmarks.hidden_effects --out cases/null --vehicle usv --effect wrong_drag
  # two effects at once, half as strong, twice the noise, under heading and depth hold
  python -m benchmarks.hidden_effects --out cases/two --vehicle mini-auv --effect ocean_current \\
      --effect thruster_lag --strength 0.5 --noise 2 --closed-loop

  python -m benchmarks.hidden_effects list                        # all effects with their equations
  python -m benchmarks.hidden_effects vehicles vehicles.json DIR  # vehicle files of another data set
  python -m benchmarks.hidden_effects demo [--cfd FOLDER]         # the logs that ship with the package

The same command gives the same files. More in benchmarks/README.md."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 0 when all went well, 2 for a request that cannot be met."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        return {"list": _list, "vehicles": _vehicles, "demo": _demo}.get(options.command, _case)(options)
    except (ValueError, OSError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        usage=f"{PROGRAM} --out DIR [options]\n       {PROGRAM} list | vehicles JSON DIR | demo",
        description=INTRODUCTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_case_options(parser)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="other commands", prog=PROGRAM)
    commands.add_parser("list", help="all effects, the vehicles that can have them, and their equations")
    vehicles = commands.add_parser("vehicles", help="vehicle files from a vehicles.json")
    vehicles.add_argument("source", type=Path, help="vehicles.json of a hidden-effect data set")
    vehicles.add_argument("folder", type=Path, help="where the TOML files go")
    demo = commands.add_parser("demo", help="the logs that ship with the package")
    demo.add_argument("--folder", type=Path, default=DEMO_DATA, help="default: src/undertow/demo_data")
    demo.add_argument("--cfd", type=Path, help="folder with the CFD surge logs, to copy them too")
    return parser


def _add_case_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--out", type=Path, metavar="DIR", help="folder of the case (made if needed)")
    add("--vehicle", choices=list(NOMINAL), default="mini-auv", help="default: %(default)s")
    add(
        "--effect",
        action="append",
        default=[],
        metavar="NAME",
        help="hidden effect; may be repeated or absent",
    )
    add("--seed", type=int, default=0, help="vehicle, guesses, commands, noise, sizes (default 0)")
    add("--strength", type=float, default=1.0, help="factor on the drawn sizes; 0 takes the effect away")
    add("--noise", type=float, default=1.0, help="factor on the noise")
    add("--duration", type=float, default=100.0, metavar="S", help="seconds per run (default 100)")
    add("--closed-loop", action="store_true", help="hold heading and depth by feedback")
    add("--run", action="append", choices=RUNS, help="only this run; may be repeated (default: all four)")


def _case(options: argparse.Namespace) -> int:
    if options.out is None:
        raise ValueError("--out DIR is missing: the folder to write the case to (see --help)")
    case = make_case(
        options.vehicle,
        tuple(options.effect),
        options.seed,
        strength=options.strength,
        noise=options.noise,
        duration=options.duration,
        closed_loop=options.closed_loop,
        runs=tuple(options.run or RUNS),
    )
    print(f"{write_case(case, options.out)}: {case.truth['class']} {case.truth['values']}")
    return 0


def _list(_: argparse.Namespace) -> int:
    for effect in EFFECTS.values():
        print(f"{effect.name}  [{effect.kind}; {', '.join(effect.vehicles)}]")
        print(textwrap.fill(effect.equation, 100, initial_indent="    ", subsequent_indent="    "))
    return 0


def _vehicles(options: argparse.Namespace) -> int:
    for path in convert_vehicles(options.source, options.folder):
        print(path)
    return 0


def _demo(options: argparse.Namespace) -> int:
    print(write_demo(options.folder))
    if options.cfd is not None:
        print(write_cfd(options.cfd, options.folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
