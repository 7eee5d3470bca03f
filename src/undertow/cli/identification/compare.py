"""Show where a model fails on logs: in which motion, in which regime, and how much of it is noise.

The model is not fitted. It is simulated from the measured motion, driven by the logged commands: once without
any correction (free run), and over short windows (prediction ahead). The force that the motion requires and
the model lacks is found by the weak form, without differentiating any signal.

--plots writes figures (PNG) to a folder: measured and simulated motion, the error map by degree of
freedom and regime, the force budget, and the residual force against every variable.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._options import JsonFileOption, VehicleArgument, bundled
from .._terminal import progress, say, section, table, write_files
from ._logs import LogOptions, LogsArgument, say_long

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.identification.comparison import ComparisonResult

_HORIZON = typer.Option(metavar="SECONDS", help="How far ahead to predict.", min=0.001)
_PLOTS = typer.Option(metavar="FOLDER", help="Write figures (PNG) to this folder.")


@bundled
def compare(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: LogOptions,
    horizon: Annotated[float, _HORIZON] = 5.0,
    json: JsonFileOption = None,
    plots: Annotated[Path | None, _PLOTS] = None,
) -> None:
    from undertow.files import check_folder, check_writable
    from undertow.identification.comparison import compare as compared
    from undertow.identification.long_logs.choosing import LOOK

    check_writable(json, inputs=[vehicle, *logs, *options.files])
    if plots is not None:
        check_folder(plots)
    loaded = options.load(vehicle, logs, budget=LOOK)
    model, runs = loaded.vehicle, loaded.runs
    with progress("comparing") as report:
        comparison = compared(model, runs, horizon=horizon, progress=report, trust_log=options.trust_log)
    long = loaded.checked({"as given": model})
    comparison = replace(comparison, result=comparison.result.model_copy(update={"long_logs": long}))
    _show(comparison.result)
    say_long(long)

    def draw(_: Path) -> dict[str, Figure]:
        from undertow.identification.report.page import comparison_pictures

        return comparison_pictures(comparison)

    write_files((json, comparison.result.to_json()), (plots, draw), silent=True)


def _show(result: ComparisonResult) -> None:
    from undertow.identification.report.sentences import useless
    from undertow.model.symbols import VELOCITY

    section("Simulated against measured", _channels(result))
    section("Force that the model lacks", _forces(result))
    if any(cell.normalised is not None for cell in result.cells):
        cells = {(c.regime, c.degree_of_freedom): c for c in result.cells}
        rows = []
        for regime in dict.fromkeys(c.regime for c in result.cells):
            row = [cells[regime, dof].normalised for dof in result.degrees_of_freedom]
            if any(value is not None for value in row):
                rows.append((regime, *(_number(value) for value in row)))
        section("Residual force, times noise", table(("regime", *result.degrees_of_freedom), rows))
    section("Force budget, % of all rms", _budget(result))
    error = "diverged" if result.prediction_error is None else f"{100 * result.prediction_error:.3g}%"
    say(f"velocity error {result.horizon:g} s ahead: {error} (geometric mean)")
    say(f"{result.vehicle}: {result.headline}", "bold")
    # Neither of a channel that rests: it has no share of its motion.
    moving = (c for c in result.channels if c.ahead_relative is not None or c.ahead_rms is None)
    doubt = useless({c.channel: c.ahead_relative for c in moving if c.channel in VELOCITY})
    if doubt:
        say(doubt, "yellow")


def _channels(result: ComparisonResult) -> Any:
    ahead, rows = f"{result.horizon:g} s ahead", []
    for c in result.channels:
        percent = None if c.ahead_relative is None else 100 * c.ahead_relative
        rms = "diverged" if c.ahead_rms is None else f"{c.ahead_rms:.3g} {c.unit}"
        fit = "diverged" if result.diverged else _number(c.free_run_fit, ".1f")
        rows.append((c.channel, rms, _number(c.ahead_normalised), _number(percent), fit))
    return table(("channel", f"{ahead}: rms", "times noise", "% of motion", "free run: fit %"), rows)


def _forces(result: ComparisonResult) -> Any:
    rows = []
    for d in result.dofs:
        name, value = max(d.inputs.items(), key=lambda item: abs(item[1]), default=("", 0.0))
        first = f"{d.autocorrelation[0]:.2f}" if d.autocorrelation else ""
        row = (_number(d.residual_rms), _number(d.noise_rms), f"{d.explained_by_noise:.0%}", first)
        most = f"{name} {value:+.2f}"
        rows.append((f"{d.degree_of_freedom} [{d.unit}]", *row, f"{d.p_value:.1g}", most))
    return table(("motion", "rms", "noise", "noise explains", "lag 1", "white: p", "most with"), rows)


def _budget(result: ComparisonResult) -> Any:
    shares = {(s.effect, s.degree_of_freedom): s.share for s in result.budget}
    rows = []
    effects = dict.fromkeys(s.effect for s in result.budget)
    for effect in sorted(effects, key=lambda name: name == "unexplained"):  # it comes last
        row = [shares.get((effect, dof)) for dof in result.degrees_of_freedom]
        rows.append((effect, *(_number(None if v is None else 100 * v, ".1f") for v in row)))
    return table(("effect", *result.degrees_of_freedom), rows)


def _number(value: float | None, style: str = ".3g") -> str:
    return "" if value is None else format(value, style)
