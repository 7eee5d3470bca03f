"""Check the gains of a control law against every stability condition, on the model of the vehicle.

Conditions come in three forms: as the mini-AUV paper prints them, with consistent units, and derived from the
model. They are checked as matrices and channel by channel; for the forward and the backward set of
parameters; over all headings and attitudes, by proof; and over the uncertainty stated in the vehicle file.
Every linearised channel is tested by Routh-Hurwitz, and the Lyapunov function is compared with the model.

    undertow gains mini-auv paper-pid
    undertow gains rov.toml my-gains.toml --form derived --repair lyapunov
    undertow gains rov.toml my-gains.toml --form derived --start "x=0.5 m, y=0.5 m, psi=20 deg"

The first line shows why the published PID gains do not work: their surge loop is unstable. In a pipeline,
--form derived leaves out the printed conditions, which ask for far more than stability needs, and --json
prints everything for a program. --repair proposes the smallest change of the gains that satisfies the literal
(printed) conditions, the lyapunov (derived) conditions, or only routh (linear stability).

--start states a box of initial errors, at rest, that the certified region has to contain. For PID laws, and
for PD laws whose own conditions are not enough, a quadratic V is searched for by a semidefinite program
(Clarabel, pip install 'undertow[certificates]') and proved by interval arithmetic, so that the solver need
not be trusted. If a V is found, it replaces the derived conditions, which are sufficient but not necessary.
With six degrees of freedom, bounds in time are also searched for, on motions that begin in the box.

The output then gives the region from which every motion comes to rest with no command beyond its thruster
limit, in errors and speeds; the behaviour of unactuated axes; and, where effects, sensors or such axes are
outside the conditions, the whole loop, linearised at all headings and simulated.

The region is for the parameters of the file. With --uncertain it has to hold for all inertia and damping
parameters within a fraction of their values, or within the intervals that the file states:

    undertow gains rov.toml my-gains.toml --form derived --start "x=0.2 m, psi=10 deg" --uncertain 10%

With --path, the conditions for the tracking error on a mission are checked instead: the law on a moving
reference and the commands that it needs, or the poles of vehicle, autopilot and line of sight on every leg
or on the tangents of a spline.

    undertow gains remus100 remus100-gains.toml --path remus100-survey.toml

With --observer, the loop with a Kalman filter is linearised as well and has to be stable; conditions and
region still assume true states.

The exit code is 0 if all conditions hold, a region is certified (or the unactuated axes come to rest) and the
whole loop is stable; 1 if something fails, is unproved or could not be analysed; 2 for a mistake in the
input.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.errors import UndertowError
from undertow.files import json_ready

from .._options import EffectsOption, JsonOption, VehicleArgument, in_si, quantities
from .._terminal import console, print_json, progress, say, section, table, text

if TYPE_CHECKING:
    from undertow.control.conditions.check import Uncertain
    from undertow.control.conditions.repair import Repair, SingleRepair
    from undertow.control.conditions.result import FullLoop, Report, Row
    from undertow.control.conditions.tracking import MissionReport


_GAINS = typer.Argument(
    metavar="GAINS", help="Gain file (TOML), or a bundled set: paper-pd, paper-pid, paper-smc."
)
_PATH = typer.Option(
    metavar="MISSION.toml", help="Check the conditions for the tracking error on this mission instead."
)
_FORM = typer.Option(help="Check only conditions of this form.", show_default="all")
_IOTA = typer.Option(
    metavar="PER_SECOND", help="The constant ι of the PID conditions.", show_default="searched for"
)
_CONFIDENCE = typer.Option(
    min=0.5, max=0.9999, help="Confidence level of the parameter intervals and ellipsoid."
)
_TILT = typer.Option(
    metavar="DEGREES", min=1.0, max=85.0, help="Largest roll and pitch that the check covers."
)
_START = typer.Option(
    metavar="NAME=SIZE,...",
    help='Largest initial errors that the region has to contain, as "x=0.5 m, psi=20 deg".',
    show_default="the largest of a few standard boxes",
)
_UNCERTAIN = typer.Option(
    metavar="SHARES",
    help="Inertia and damping parameters over whose whole range the region has to "
    "hold: within a fraction (10%), some by name (m=5%,X_u=20%), or `stated` for the intervals of the file.",
    show_default="the values of the file",
)
_OBSERVER = typer.Option(
    metavar="FILE", help="Also analyse the loop with the Kalman filter of this observer file."
)
_REPAIR = typer.Option(help="Propose the smallest change of the gains that satisfies these conditions.")


def gains(
    vehicle: VehicleArgument,
    gains: Annotated[str, _GAINS],
    path: Annotated[Path | None, _PATH] = None,
    form: Annotated[Literal["printed", "units", "derived"] | None, _FORM] = None,
    iota: Annotated[float | None, _IOTA] = None,
    confidence: Annotated[float, _CONFIDENCE] = 0.95,
    tilt: Annotated[float, _TILT] = 60.0,
    start: Annotated[str | None, _START] = None,
    uncertain: Annotated[str | None, _UNCERTAIN] = None,
    observer: Annotated[Path | None, _OBSERVER] = None,
    repair: Annotated[Literal["literal", "lyapunov", "routh"] | None, _REPAIR] = None,
    json: JsonOption = False,
    effects: EffectsOption = None,
) -> int:
    from undertow.control.api import check_gains
    from undertow.control.conditions.problem import Problem
    from undertow.control.conditions.repair import repair as repaired
    from undertow.control.conditions.repair import single_repairs
    from undertow.control.gains import load_gains
    from undertow.model.loading import last_covariance, load_vehicle, read_vehicle_table, resolve_vehicle
    from undertow.model.symbols import MOTION_UNITS

    if path is not None:
        if observer is not None:
            raise UndertowError(
                f"--observer {observer}: on a mission the loop is judged with true states; leave --path or "
                "--observer out, or simulate both together"
            )
        if uncertain is not None:
            raise UndertowError(
                "--uncertain: conditions on a mission are for the values of the file; leave --path or "
                "--uncertain out"
            )
        return _on_mission(vehicle, gains, path, tilt, json, effects)
    with progress("checking the gains") as report:
        model = load_vehicle(vehicle, effect_files=effects or [])
        covariance = last_covariance(read_vehicle_table(resolve_vehicle(vehicle)).history, model)
        chosen = load_gains(gains, model)
        found = check_gains(
            model,
            chosen,
            confidence=confidence,
            covariance=covariance,
            forms=[form] if form else [],
            iota=iota,
            tilt=tilt,
            start=quantities("--start", [start], MOTION_UNITS, example="x=0.5")
            if start is not None
            else None,
            uncertain=_shares(uncertain),
            observer=observer,
            progress=report,
        )
        problem = Problem(chosen, math.radians(tilt))
        alone, together = single_repairs(problem), repaired(problem, repair) if repair else None
    (_show_json if json else show)(found, alone, together)
    return 0 if found.ok else 1


def _shares(text: str | None) -> Uncertain:
    """What --uncertain says: a share, shares by name, or the intervals of the file."""
    if text is None or text == "stated":
        return text  # type: ignore[return-value]
    if "=" not in text:
        return in_si("--uncertain", text, "1")
    return quantities("--uncertain", [text], {}, example="m=5%")


def _on_mission(
    vehicle: str, gains: str, path: Path, tilt: float, json: bool, effects: list[Path] | None
) -> int:
    """Check and print the conditions on a mission."""
    from undertow.control.conditions.tracking import check_mission
    from undertow.control.gains import load_gains
    from undertow.control.guidance.mission import load_mission
    from undertow.model.loading import load_vehicle

    with progress("checking the mission", None):
        model = load_vehicle(vehicle, effect_files=effects or [])
        found = check_mission(load_gains(gains, model), load_mission(path), math.radians(tilt))
    if json:
        print_json(json_ready({"schema": MISSION_SCHEMA, "ok": found.ok, **asdict(found)}))
    else:
        show_mission(found)
    return 0 if found.ok else 1


def show_mission(report: MissionReport) -> None:
    """Print the conditions on a mission, and what each is for."""
    fate = "all conditions hold" if report.ok else "some conditions fail or are not proved"
    say(f"{report.gains} ({report.law}) on {report.vehicle}, mission '{report.mission}': {fate}")
    section("Conditions for the error on the mission")
    for number, row in enumerate(report.rows, 1):
        line = f"  {row.statement}: {row.verdict}, margin {row.margin:.4g} ({number})"
        console().print(text(line, _GREEN if row.verdict == "holds" else _RED))
    for number, row in enumerate(report.rows, 1):
        say(f"  {number}: {row.where}")
        say(f"     {row.about}", "dim")
    for name, why in report.not_covered.items():
        say(f"  {name} is not in them: {why}")


MISSION_SCHEMA = "undertow/mission-report/2"
"""Of what --json prints with --path; docs/missions.md documents it."""

SCHEMA = "undertow/gain-report/2"
"""Of what --json prints; docs/gains.md documents it."""
_GREEN, _RED = "green", "red"


def _show_json(report: Report, singles: Sequence[SingleRepair], repair: Repair | None) -> None:
    """Everything as JSON; roots as [real, imaginary], what has no end as null."""
    content = {
        "schema": SCHEMA,
        "ok": report.ok,
        **asdict(report),
        "single_repairs": [asdict(s) for s in singles],
        "repair": asdict(repair) if repair else None,
    }
    print_json(json_ready(content))


def show(report: Report, singles: Sequence[SingleRepair] = (), repair: Repair | None = None) -> None:
    """Print the report, with the repairs that were asked for."""
    from undertow.control.conditions.by_law import FORMS

    say(f"{report.gains} ({report.law}) on {report.vehicle}: {_headline(report)}")
    for form in dict.fromkeys(r.form for r in report.rows):
        own = [r for r in report.rows if r.form == form]
        section(f"Conditions {FORMS[form]}")
        _show_matrices([r for r in own if r.scope == "matrices"])
        _show_channels([r for r in own if r.scope != "matrices"])
        for agreement in (a for a in report.agreements if a.form == form):
            span = f"{_bounds(agreement.iota)} 1/s" if agreement.iota else "there is none"
            say(f"  one ι for all of them, in every set of parameters: {span}")
        _explain(own)
    _show_routh(report)
    _show_lyapunov(report)
    _show_region(report)
    _show_uncertain(report)
    _show_repairs(singles, repair)
    _show_remainder(report)


def _headline(report: Report) -> str:
    if not report.conditions_hold and report.ok:
        by = "a quadratic V" if report.region.quadratic is not None else "bounds in time"
        return f"certified by {by}; sufficient conditions that are not necessary fail"
    if not report.conditions_hold:
        unproved = any(r.verdict == "not proved" for r in report.rows)
        refuted = any(r.verdict in ("fails", "no iota") for r in report.rows) or not unproved
        return "some conditions fail" if refuted else "some conditions are not proved"
    but = []
    if report.not_covered:
        one = len(report.not_covered) == 1
        but.append(f"{', '.join(report.not_covered)} {'is' if one else 'are'} not in them")
    if report.zero_dynamics:
        axes, stable = report.zero_dynamics.axes, report.zero_dynamics.stable
        verbs = ("is", "comes", "does not come") if len(axes) == 1 else ("are", "come", "do not come")
        but.append(f"{', '.join(axes)} {verbs[0]} unactuated and {verbs[1 if stable else 2]} to rest")
    elif report.region.kind == "none":
        but.append("no region is certified")
    if report.region.contains_start is False:
        but.append("the start box is not contained")
    for words, loop in (
        ("the whole loop", report.full_loop),
        ("the loop with the observer", report.loop_with_observer),
    ):
        if loop is not None and not loop.stable:
            but.append(f"{words} is {loop.verdict}")
    return "all conditions hold" + (f", but {', and '.join(but)}" if but else "")


def _show_matrices(rows: list[Row]) -> None:
    """Each condition with its numbers, `λmin(K_V) > λmax(M_q): 0.005 > 10.088 fails`, and why it is so."""
    if not rows:
        return
    places = list(dict.fromkeys(r.where for r in rows))
    console().print(text("  as matrices", "dim"))
    for r in rows:
        signs = f"{r.signs}; " if r.signs else ""
        line = f"  {r.statement}: {_with_numbers(r)} ({signs}see {places.index(r.where) + 1})"
        console().print(text(line, _GREEN if r.verdict == "holds" else _RED))
    for number, place in enumerate(places, 1):
        say(f"  {number}: {place}")


def _with_numbers(row: Row) -> str:
    if row.verdict == "no iota":
        return _verdict(row)
    if "λmax" in row.statement:
        return f"{_distinct_digits(row.left, row.right)}{_at_iota(row)} {_verdict(row)}"
    return f"λmin {_number(row.margin)} > 0{_at_iota(row)} {_verdict(row)}"


def _distinct_digits(left: float, right: float) -> str:
    """Both sides with as many digits as tell them apart, five at least."""
    digits = next((n for n in range(5, 17) if f"{left:.{n}g}" != f"{right:.{n}g}"), 17)
    return f"{left:.{digits}g} > {right:.{digits}g}"


def _show_channels(rows: list[Row]) -> None:
    """One line for each condition and set of parameters, one column for each channel."""
    if not rows:
        return
    coordinates = list(dict.fromkeys(r.scope for r in rows))
    lines = []
    for condition in dict.fromkeys(r.condition for r in rows):
        own = {(r.signs, r.scope): r for r in rows if r.condition == condition}
        signs = [s for s in dict.fromkeys(s for s, _ in own) if s != "both"] or ["both"]
        for sign in signs:
            found = [own.get((sign, c)) or own[("both", c)] for c in coordinates]
            shown = [text(_verdict(r), _GREEN if r.verdict == "holds" else _RED) for r in found]
            lines.append((found[0].statement, sign, *shown))
    console().print()
    console().print(table(("channel by channel", "parameters", *coordinates), lines))


def _verdict(row: Row) -> str:
    if row.uses_iota:
        return f"{row.verdict}; {_bounds(row.iota)}" if row.iota else "no ι"
    reached = row.where if row.scope != "matrices" else ""
    return f"{row.verdict}; {reached}" if reached else row.verdict


def _bounds(span: tuple[float, float]) -> str:
    low, high = span
    if low == 0.0:
        return "any ι" if math.isinf(high) else f"ι < {high:.6g}"
    return f"ι > {low:.6g}" if math.isinf(high) else f"ι {low:.6g} to {high:.6g}"


def _number(value: float) -> str:
    return f"{value:.6g}" if abs(value) > 1e-300 else "0"


def _explain(rows: list[Row]) -> None:
    first = {r.condition: r for r in reversed(rows)}
    for r in reversed(first.values()):
        say(f"  {r.statement}: {r.about} ({r.source})", "dim")


def _show_routh(report: Report) -> None:
    from undertow.control.conditions.result import SETTINGS

    if not report.channels:
        return
    section("Linearised channels at rest (Routh-Hurwitz)")
    rows = []
    for c in report.channels:
        stability = text("stable", _GREEN) if c.stable else text("unstable", _RED)
        rows.append(
            (c.coordinate, c.signs, ", ".join(map(_number, c.first_column)), _roots(c.roots), stability)
        )
    console().print(table(("channel", "parameters", "first column", "roots, 1/s", ""), rows))
    for name, roots in report.coupled.items():
        grows = roots[0].real > SETTINGS.slowest_decay
        of = f", {name}" if name else ""
        say(f"  all axes together{of}: {_roots(roots)}{'; UNSTABLE' if grows else ''}", _RED if grows else "")
    if any(c.coordinate == "x heading east" for c in report.channels):
        say("  gains of x and y differ: conditions channel by channel are for heading north", "dim")
    for channel in report.channels:
        if not channel.stable:
            of = f" ({channel.signs})" if channel.signs else ""
            say(f"  the loop in {channel.coordinate}{of} is linearly unstable: {_roots(channel.roots)}", _RED)


def _roots(roots: Sequence[complex]) -> str:
    """Complex pairs once, with both signs."""
    shown = []
    for root in roots:
        if abs(root.imag) < 1e-12:
            shown.append(f"{root.real:+.6f}")
        elif root.imag > 0:
            shown.append(f"{root.real:+.6f} +- {root.imag:.6f}i")
    return ", ".join(shown)


def _show_lyapunov(report: Report) -> None:
    section("Lyapunov function")
    found = report.lyapunov
    rows = [
        ("V", found.V),
        ("V_dot", found.V_dot),
        ("in the paper", found.equation),
        ("checked", found.identity),
        ("V_dot = 0", found.zero_set),
        ("largest invariant subset", found.invariant),
    ]
    console().print(table(("", ""), rows))


def _show_region(report: Report) -> None:
    found = report.region
    section("Certified region")
    say(f"  {found.text}", _RED if found.kind == "none" and not report.zero_dynamics else "")
    if found.contains_start is not None:
        word = (
            "contained: every motion that begins in it at rest comes to rest"
            if found.contains_start
            else "NOT held"
        )
        say(f"  start box {_with_units(found.start)}: {word}", "" if found.contains_start else _RED)
    if found.quadratic is not None:
        say(f"  V is at most {found.quadratic.start:.3g} on the start box; the level is 1")
    if found.parameters:
        spans = (f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in found.parameters.items())
        say(f"  uncertain parameters, SI: {', '.join(spans)}")
    if found.errors:
        together = "together" if found.transient is not None else "one error at a time"
        say(f"  starts at rest: {_with_units(found.starts)}, {together}")
        say(f"  largest errors: {_with_units(found.errors)}")
        say(f"  largest speeds: {_with_units(found.speeds)}")
    for c in found.commands:
        say(f"  {c.name}: {c.steady:.4g} at the set-point, at most {c.largest:.4g} of {c.limit:.4g} in it")
    if found.commands:
        say("  within it no command reaches its limit, so anti-windup never acts", "dim")
    if report.not_covered and found.kind != "none":
        say(
            f"  this is the loop without {', '.join(report.not_covered)}; the loop with it is judged below",
            "dim",
        )


def _with_units(values: Mapping[str, float]) -> str:
    """Numbers with units; angles in degrees as well."""
    return ", ".join(f"{name} {_with_unit(name, value)}" for name, value in values.items())


def _with_unit(name: str, value: float) -> str:
    if name in ("phi", "theta", "psi"):
        return f"{math.degrees(value):.4g} deg" if value < math.pi else "any"
    return f"{value:.4g} {dict(p='rad/s', q='rad/s', r='rad/s', u='m/s', v='m/s', w='m/s').get(name, 'm')}"


def _show_uncertain(report: Report) -> None:
    section(f"Over the uncertainty of the parameters ({report.uncertainty})")
    open_rows = list(_uncertain(report.rows))
    uncertain = [r for r in report.rows if r.box is not None]
    if not uncertain:
        say("  no condition contains a parameter with a standard deviation")
        return
    sure = sum(r.box.verdict == r.ellipsoid.verdict == "holds for all" for r in uncertain)  # type: ignore[union-attr]
    failing = sum(r.verdict == "fails" for r in uncertain)
    without = sum(r.verdict == "no iota" for r in uncertain)
    counts = {
        "hold for all": sure,
        "fail at the values of the file": failing,
        "have no ι there": without,
        "in between": len(uncertain) - sure - failing - without,
    }
    counted = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    say(f"  of {len(uncertain)} conditions with uncertain parameters {counted}{':' if open_rows else ''}")
    if open_rows:
        heads = ("condition", "channel", "parameters", "intervals", "ellipsoid", "fails at")
        console().print(table(heads, open_rows))


def _uncertain(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    for row in rows:
        if row.box is None or row.ellipsoid is None:
            continue
        known = row.verdict in ("fails", "no iota")
        if known or row.box.verdict == row.ellipsoid.verdict == "holds for all":
            continue
        example = row.box.counterexample or row.ellipsoid.counterexample
        shown = ", ".join(f"{n} = {v:.5g}" for n, v in example.items())
        yield (
            *(row.statement, row.scope, row.signs, f"{row.box.verdict}{_at_iota(row)}"),
            *(row.ellipsoid.verdict, shown),
        )


def _at_iota(row: Row) -> str:
    return f" at ι = {row.at_iota:.4g}" if row.at_iota is not None else ""


def _show_repairs(singles: Sequence[SingleRepair], repair: Repair | None) -> None:
    if singles:
        section("Repairs by one gain alone")
        rows = ((f"{s.coordinate}: {s.kind}", s.signs, f"{s.gain} {_rounded_bound(s)}") for s in singles)
        console().print(table(("to satisfy", "parameters", "one of"), rows))
    if repair is None:
        return
    section(f"Smallest change of all gains together ({repair.kind})")
    if not repair.found:
        say("  none was found")
        return
    rows_of = [
        (f"{name}_{c}", f"{value:.6g}", f"{repair.factors[name][c]:.6g}")
        for name, values in repair.gains.items()
        for c, value in values.items()
    ]
    if rows_of:
        console().print(table(("gain", "new value", "times the old one"), rows_of))
    else:
        say("  no change is needed for these conditions")
    if repair.iota is not None:
        say(f"  with ι = {repair.iota:.6g} 1/s")
    say(f"  {repair.method}", "dim")


def _rounded_bound(single: SingleRepair) -> str:
    """The bound rounded to the side on which the condition holds."""
    if single.bound is None:
        return "alone never suffices"
    way = ROUND_CEILING if single.above else ROUND_FLOOR
    rounded = Context(prec=6, rounding=way).create_decimal_from_float(single.bound)
    return f"{'>' if single.above else '<'} {float(rounded):.6g}"


def _show_remainder(report: Report) -> None:
    if report.zero_dynamics:
        section("Axes that no thruster pushes")
        say(f"  {report.zero_dynamics.text}", "" if report.zero_dynamics.stable else _RED)
        say(f"  poles of their own motion: {_roots(report.zero_dynamics.poles)} 1/s")
    if report.not_covered:
        section("Not in the conditions")
        console().print(table(("", ""), report.not_covered.items()))
    if report.full_loop is not None:
        style = "" if report.full_loop.stable else _RED
        say(f"  full loop linearised at rest: {_full_loop(report.full_loop)}", style)
        if report.full_loop.simulated:
            say(f"  full loop simulated: {report.full_loop.simulated}", style)
    if report.loop_with_observer is not None:
        section("With the observer")
        style = "" if report.loop_with_observer.stable else _RED
        say(f"  loop with the observer, linearised at rest: {_full_loop(report.loop_with_observer)}", style)
        say("  conditions and certified region are for true states, not for estimates", "dim")


def _full_loop(whole: FullLoop) -> str:
    if whole.pole is None or whole.verdict not in ("stable", "unstable"):
        return whole.text
    verdict = "stable" if whole.stable else "UNSTABLE"
    at = f" ({whole.text})" if whole.text else ""
    return f"{verdict}, slowest or growing pole {_roots([whole.pole])} 1/s{at}"
