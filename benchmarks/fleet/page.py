"""docs/fleet.md from a run and its costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

# What a reader may replace by own numbers.
_ROWS, _CORE_HOUR, _BYTES, _STORE_RATE, _FACTOR = 1e12, 0.04, 50.0, 0.1e9, 30e3
_PARTITION = 86_400 * 10


@dataclass(frozen=True)
class Costs:
    """What was measured.

    Attributes
    ----------
    rows : int
        Rows of logs.
    rates : mapping
        Rows per second by number of workers; 0 is one process without Dask.
    apart : float
        Largest relative distance of results on workers from those of one process.
    memory : mapping
        Rows of a log to memory before it and peak, MB.
    size : int
        Bytes of the logs.
    load : float
        Processes that wanted the processors besides, at the end.
    cores : int
        Processors.
    """

    rows: int
    rates: Mapping[int, float]
    apart: float
    memory: Mapping[int, tuple[float, float]]
    size: int
    load: float
    cores: int


def page(shown: Sequence[tuple[str, str]], report: str, names: str, costs: Costs) -> str:
    """The page."""
    example = "\n".join(f"```\n$ {command}\n{printed}\n```\n" for command, printed in shown)
    template = Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8"))
    return template.substitute(
        example=example, report=_quoted(report), names=names, costs=_costs(costs), paper=_paper(costs)
    )


def _quoted(report: str) -> str:
    return "\n".join(f"> {line}".rstrip() for line in report.splitlines()) + "\n"


def _costs(costs: Costs) -> str:
    names = {0: "one process, without Dask", 1: "one worker", 2: "two workers"}
    rows = [
        f"| {names[w]} | {rate:,.0f} | {rate / max(w, 1):,.0f} | {rate / costs.rates[0]:.2f} |"
        for w, rate in costs.rates.items()
    ]
    memory = [f"| {n:,} | {a:.0f} | {b:.0f} |" for n, (a, b) in costs.memory.items()]
    small, large = (costs.memory[n][1] for n in sorted(costs.memory))
    scaling, overhead = costs.rates[2] / costs.rates[1], 1 - costs.rates[1] / costs.rates[0]
    reported = (
        f"From one worker to two: {scaling:.2f} times as fast. One worker against the path without Dask: "
        f"{overhead:+.0%} of its time is overhead. Results on workers and in one process are "
        f"{costs.apart:.1g} apart (1e-10 is the limit). The peak of a worker grows by {large - small:.0f} MB "
        f"where the log is four times as long. Measured with a load of {costs.load:.1f} on {costs.cores} "
        f"processors: above {costs.cores}, others were at work, too, and scaling is worse than on an idle "
        "machine."
    )
    return "\n".join(
        [
            "## What it costs\n",
            f"{costs.rows:,} rows of the craft above (3 motions, 65 columns), workers warm, best of three.\n",
            "| | rows/s | rows/s per worker | against one process |",
            "| --- | ---: | ---: | ---: |",
            *rows,
            "",
            "| rows of one log | memory before, MB | peak, MB |",
            "| ---: | ---: | ---: |",
            *memory,
            "",
            f"{reported}\n",
        ]
    )


def _paper(costs: Costs) -> str:
    rate = costs.rates[1]
    core_hours = _ROWS / rate / 3600
    reading = _ROWS * _BYTES / _STORE_RATE / 3600
    partitions = _ROWS / _PARTITION
    lines = [
        "## 10¹² rows, on paper\n",
        f"Assumed: 10 Hz, so that a day of one vehicle is {_PARTITION:,} rows and 10¹² rows are "
        f"{partitions:,.0f} days ({partitions / 365:,.0f} vehicle years); {_BYTES:.0f} bytes a row in "
        f"Parquet; {_CORE_HOUR} $ for an hour of a core; {_STORE_RATE / 1e6:.0f} MB/s from storage for each "
        "worker; the rate of one worker from above.\n",
        "| | |",
        "| --- | ---: |",
        f"| work of cores | {core_hours:,.0f} h |",
        f"| with 1000 cores | {core_hours / 1000:,.1f} h |",
        f"| cost of the cores | {core_hours * _CORE_HOUR:,.0f} $ |",
        f"| data | {_ROWS * _BYTES / 1e12:.0f} TB |",
        f"| reading, of all workers together | {reading:,.0f} h ({reading / core_hours:.1%} of the work) |",
        f"| hashing at 1 GB/s | {_ROWS * _BYTES / 1e9 / 3600:,.0f} h |",
        f"| results kept ({_FACTOR / 1e3:.0f} kB each) | {partitions * _FACTOR / 1e9:.0f} GB |",
        f"| tasks for the scheduler at 1 ms each | {2 * partitions / 1000 / 60:.0f} min |",
        "",
        "The bottleneck is the evaluation of the model and its derivatives in all columns, in the workers, "
        "and it is divided by any number of them. Reading and hashing are small beside it; the scheduler has "
        "two tasks for each day and never more than three for each worker at a time. What is left in the "
        "process that started the run is loading results and putting them together, vehicle by vehicle: "
        f"hours, and {partitions * _FACTOR / 1e9:.0f} GB of its memory, for all of these days. It is what "
        "would have to be spread next; vehicles are independent of each other but for Holm's rule.\n",
    ]
    return "\n".join(lines)
