"""docs/profile.md from measurements."""

from __future__ import annotations

import ast
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

`undertow diagnose` with the whole catalogue: vehicle `{vehicle}` of `benchmarks.hidden_effects` with
`{hidden}` hidden (seed {seed}), six degrees of freedom, three runs of 100 s to fit and one for validation, 20
Hz. Its answer: {named}. Compiled code is cached and files are read before; only the diagnosis is timed. A
sampling profiler on CPU time records every {interval:.0f} ms which module is running; NumPy, SciPy and
compiled code count for the module that called them. Everything runs in one process (`UNDERTOW_JOBS=1`); on
several cores the candidates, their fits and the doctor run in parallel.

![CPU seconds by module, stacked by stage]({picture})

## Stages

{stages}
## Modules

{modules}
## What it means

{meaning}

## Against the number of effects

The same data and model with different numbers of candidate effects (without the profiler), in CPU time.

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


def _stages(profile: Profile) -> str:
    whole = sum(profile.stages.values())
    lines = ["| stage | processor, s | share |", "| --- | ---: | ---: |"]
    lines += [f"| {s} | {t:.2f} | {t / whole:.0%} |" for s, t in profile.stages.items()]
    return "\n".join([*lines, f"| **all** | **{whole:.2f}** | |"]) + "\n"


def _modules(profile: Profile) -> str:
    found, whole = profile.by_module, sum(profile.modules.values())
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
    used = profile.stages
    whole = sum(used.values())
    (longest, first), (next_, second), (_, third), *_ = used.items()
    searched = sum(t for s, t in used.items() if s.startswith("search")) / whole
    return (
        f"{searched:.0%} of the work is the search for the effect, {1 - searched:.0%} is around\n"
        f"it (examining the logs, simulating the result). The longest stage, *{longest}*,\n"
        f"takes {first / whole:.0%}, the next, *{next_}*, {second / whole:.0%}. Without any one of the\n"
        f"others the diagnosis would be at most {whole / (whole - third):.2f} times as fast."
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
