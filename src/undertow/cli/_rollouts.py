"""What `undertow fleet rollouts` does, shows and writes."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from undertow.cli._progress import progress
from undertow.cli._show import console, section, table, text
from undertow.cli._vehicle_and_logs import Fill
from undertow.errors import UndertowError
from undertow.files import check_writable, write_whole
from undertow.fleet.engine import Engine
from undertow.fleet.rollouts import Band, Flights
from undertow.fleet.rollouts import rollouts as roll_out

_INCOMPLETE = 1


def rolled(
    engine: Engine,
    vehicle: str,
    logs: Sequence[Path],
    count: int,
    horizon: float,
    coverage: float,
    seed: int,
    out: Path | None,
    map: Path | None,
    effects: Sequence[Path] | None,
    fill: Fill | None,
    trust_log: bool,
) -> int:
    """Roll out, print how the logs lie in the bands, write the bands; 1 where something is missing."""
    from undertow.identification.logs import Mapping, read_mapping

    files = tuple(str(f.absolute()) for f in effects or ())
    check_writable(out, inputs=[*logs, vehicle, *files])
    missing = next((log for log in logs if not log.is_file()), None)
    if missing is not None:
        raise UndertowError(f"log {missing} does not exist or is not a file: give the path of a log")
    seen = str(Path(vehicle).absolute()) if Path(vehicle).is_file() else vehicle
    mapping = (Mapping() if map is None else read_mapping(map)).model_dump_json()
    flights = Flights(seen, files, mapping, fill, horizon, coverage, seed, trust_log)
    with progress("rolling out") as tell:
        bands, failed, source = roll_out(flights, [str(p.absolute()) for p in logs], count, engine, tell)
    heads = ("channel", "within the band, %", "half width at the end", "half width in noise")
    section(
        f"{count} rollouts of {len(bands)} windows of {horizon:g} s; {source}", table(heads, _rows(bands))
    )
    diverged = sum(b.diverged for b in bands)
    if diverged:
        of = count * len(bands)
        told = (
            f"  {diverged} of {of} rollouts diverged and are left out: the bands are too narrow without them"
        )
        console().print(text(told, "yellow"), soft_wrap=True)
    _warn(bands, coverage)
    for place, words in failed.items():
        told = words if place.partition(",")[0] in words else f"{place}: {words}"
        console().print(text(f"left out: {told}", "yellow"), soft_wrap=True)
    if out is not None:
        write_whole(out, parquet(bands))
        console().print(text(f"wrote {out}"))
    return _INCOMPLETE if failed or diverged else 0


def shares(bands: Sequence[Band]) -> dict[str, float]:
    """Share of the measurement that lies within the band, by channel that is measured."""
    found = {}
    for i, name in enumerate(bands[0].names):
        inside = [(b.low[1:, i] <= m) & (m <= b.high[1:, i]) for b in bands if _there(m := b.measured[1:, i])]
        if inside:
            found[name] = float(np.mean(np.concatenate(inside)))
    return found


def _there(measured: np.ndarray) -> bool:
    return bool(np.isfinite(measured).all())


def _rows(bands: Sequence[Band]) -> Iterator[tuple[str, ...]]:
    for name, share in shares(bands).items():
        i = bands[0].names.index(name)
        end = float(np.mean([b.high[-1, i] - b.low[-1, i] for b in bands])) / 2
        first = float(np.mean([b.high[0, i] - b.low[0, i] for b in bands])) / 2
        yield name, f"{100 * share:.3g}", f"{end:.3g}", f"{end / max(first, 1e-300):.3g}"


def _warn(bands: Sequence[Band], coverage: float) -> None:
    low = [name for name, share in shares(bands).items() if share < 1 - 3 * (1 - coverage)]
    if low:
        console().print(
            text(
                f"  {', '.join(low)}: the logs leave the band of {coverage:.0%} more than three times as "
                "often as they should: the model lacks more than its parameters say (undertow diagnose)",
                "yellow",
            ),
            soft_wrap=True,
        )


def parquet(bands: Sequence[Band]) -> bytes:
    """Bands as a table: log, window, t, and for each channel the measurement, low, median and high."""
    import polars as pl

    parts = []
    for b in bands:
        columns = {"t": b.t}
        for i, name in enumerate(b.names):
            kinds = (("measured", b.measured), ("low", b.low), ("median", b.median), ("high", b.high))
            columns |= {f"{name}_{kind}": values[:, i] for kind, values in kinds}
        told = pl.DataFrame(columns)
        parts.append(told.select(pl.lit(b.log).alias("log"), pl.lit(b.window).alias("window"), pl.all()))
    stream = io.BytesIO()
    pl.concat(parts).write_parquet(stream)
    return stream.getvalue()
