"""docs/profile.md from measurements."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import undertow

from .case import HIDDEN, SEED, VEHICLE
from .clock import INTERVAL
from .measure import Profile

SHOWN = 12
PICTURE = "images/profile.png"
_TEXT = """\
# Where the time of a diagnosis goes

Made by `python -m benchmarks.profile` ({machine}).

`undertow diagnose` over the whole catalogue: vehicle `{vehicle}` of `benchmarks.hidden_effects` with
`{hidden}` hidden (seed {seed}), six degrees of freedom, three runs of 100 s to fit to and one to judge by,
20 Hz. It answers: {named}. Compiled code is in the cache, files are read; what is timed is the diagnosis. A
timer that counts processor time looks every {interval:.0f} ms which module is at work; what NumPy, SciPy and
compiled code do counts for the module that called them. All in one process (`UNDERTOW_JOBS=1`); on several
cores the candidates, their fits and the doctor run beside each other. Wall time is longer than processor time
where other programs kept the machine busy.

![Seconds of the processor by module, stacked by stage]({picture})

## Stages

{stages}
## Modules

{modules}
## What it means

{meaning}

## Against the number of effects

The same data and model; only the number of effects that may be missing differs (without the profiler).
Processor time, as it is less shaken by other programs.

{growth}
{slope}
"""


def page(profile: Profile, growth: dict[int, float], machine: str) -> str:
    """The page."""
    return _TEXT.format(
        machine=machine,
        vehicle=VEHICLE,
        hidden=HIDDEN,
        seed=SEED,
        named=f"missing is `{'`, `'.join(profile.named)}`" if profile.named else "nothing is missing",
        interval=1000 * INTERVAL,
        picture=PICTURE,
        stages=_stages(profile),
        modules=_modules(profile),
        meaning=_meaning(profile),
        growth=_growth(growth),
        slope=_slope(growth),
    )


def by_module(profile: Profile) -> list[tuple[str, dict[str, float]]]:
    """Seconds of every module by stage, the busiest module first."""
    found: dict[str, dict[str, float]] = defaultdict(dict)
    for (name, stage), seconds in profile.modules.items():
        found[name][stage] = seconds
    return sorted(found.items(), key=lambda one: -sum(one[1].values()))


def _stages(profile: Profile) -> str:
    wall, cpu = sum(profile.wall.values()), sum(profile.cpu.values())
    lines = ["| stage | wall, s | processor, s | share of the processor |", "| --- | ---: | ---: | ---: |"]
    lines += [f"| {s} | {profile.wall[s]:.2f} | {c:.2f} | {c / cpu:.0%} |" for s, c in profile.cpu.items()]
    return "\n".join([*lines, f"| **all** | **{wall:.2f}** | **{cpu:.2f}** | |"]) + "\n"


def _modules(profile: Profile) -> str:
    found, whole = by_module(profile), sum(profile.modules.values())
    lines = ["| module of `undertow` | processor, s | share | most of it in | what the module is |"]
    lines += ["| --- | ---: | ---: | --- | --- |"]
    for name, stages in found[:SHOWN]:
        used = sum(stages.values())
        most = max(stages, key=lambda s: stages[s])
        lines.append(f"| `{name}` | {used:.2f} | {used / whole:.0%} | {most} | {_first_line(name)} |")
    rest = sum(sum(stages.values()) for _, stages in found[SHOWN:])
    return (
        "\n".join([*lines, f"| {len(found[SHOWN:])} others | {rest:.2f} | {rest / whole:.0%} | | |"]) + "\n"
    )


def _first_line(module: str) -> str:
    path = Path(undertow.__file__).parent / (module.replace(".", "/") + ".py")
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) if path.is_file() else None
    return " ".join((text or "").partition("\n\n")[0].split()).replace("|", "\\|")


def _meaning(profile: Profile) -> str:
    used, cpu = profile.cpu, sum(profile.cpu.values())
    slow = sorted(used, key=lambda s: -used[s])
    longest, next_ = (f"{used[stage] / cpu:.0%}" for stage in slow[:2])
    (first, first_stages), (second, second_stages) = by_module(profile)[:2]
    both = (sum(first_stages.values()) + sum(second_stages.values())) / sum(profile.modules.values())
    searched = sum(c for s, c in used.items() if s.startswith("search")) / cpu
    busy = cpu / sum(profile.wall.values())
    return (
        f"{searched:.0%} of the work is the search for the effect, {1 - searched:.0%} stands around\n"
        f"it (examining the logs, simulating the result). The longest stage, *{slow[0]}*,\n"
        f"takes {longest}, the next, *{slow[1]}*, {next_}. Without any one of the others the\n"
        f"diagnosis would be at most {cpu / (cpu - used[slow[2]]):.2f} times as fast. The modules\n"
        f"`{first}` and `{second}` do {both:.0%} of the work.\n"
        f"Processor over wall time is {busy:.2f}, where 1 is a core for this process alone."
    )


def _growth(growth: dict[int, float]) -> str:
    lines = ["| effects that may be missing | processor, s |", "| ---: | ---: |"]
    return "\n".join([*lines, *(f"| {n} | {t:.1f} |" for n, t in growth.items())]) + "\n"


def _slope(growth: dict[int, float]) -> str:
    (few, short), *_, (many, long) = growth.items()
    each = (long - short) / (many - few)
    rest = short - few * each
    parts = "the doctor, the model as it is, the judgement by simulation"
    added = f"From {few} to {many} effects each one adds {each:.2f} s; {rest:.1f} s would be left with"
    return f"{added}\nnone ({parts})."
