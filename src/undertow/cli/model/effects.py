"""List the catalogue of effects, show or check an effect, or start one of your own.

Without a subcommand, it lists the catalogue. `show` prints the physics of one effect, `check` checks a file
of your own, `new` writes such a file from the unexplained residual of a diagnosis.

    undertow diagnose rov.toml run1.csv run2.csv --json found.json
    undertow effects new turning_drag --from found.json
    undertow effects check turning_drag.py
    undertow diagnose rov.toml run1.csv run2.csv --effects turning_drag.py
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._options import EffectsOption, JsonOption, NewForceOption, new_file
from .._terminal import console, print_json, progress, say, section, table, text

if TYPE_CHECKING:
    from undertow.model.contract import ContractCheck
    from undertow.model.describe import Description, ParameterNote
    from undertow.model.effect import Effect

app = typer.Typer(add_completion=False)

_ID = typer.Argument(metavar="ID", help="Id of the effect; 'undertow effects' lists them.")
_FILE = typer.Argument(metavar="FILE", help="Python file with effects of your own; it is executed.")
_FROM = typer.Option("--from", metavar="DIAGNOSIS.json", help="Result of 'undertow diagnose --json'.")
_OUT = typer.Option(metavar="FILE", help="Output file.", show_default="ID.py")
_FAMILIES = ("inertia", "damping", "statics", "water", "tether", "actuation", "measurement", "memory")


@app.callback(invoke_without_command=True)
def effects(context: typer.Context, json: JsonOption = False, effects: EffectsOption = None) -> None:
    from undertow.model.catalogue import with_effects

    if context.invoked_subcommand is not None:
        return
    known = with_effects(effects or [])
    if json:
        print_json([_summary(cls) for cls in known.values()])
    else:
        console().print(table(("family", "id", "meaning"), _listed(known), indent=0))


@app.command()
def show(id: Annotated[str, _ID], json: JsonOption = False, effects: EffectsOption = None) -> None:
    """Show meaning, equations, parameters, reference and typical signature of an effect."""
    from undertow.model.catalogue import lookup, with_effects
    from undertow.model.describe import describe

    known = with_effects(effects or [])
    description = describe(lookup(id, known), known)
    if json:
        print_json(description.as_dict())
    else:
        _print_description(description)


@app.command()
def check(file: Annotated[Path, _FILE]) -> int:
    """Check a file with effects of your own. The file is executed.

    It checks units, behaviour at zero, linearity, symmetry and sign of the inertia, power and documentation.
    The exit code is 1 if a check fails.
    """
    from undertow.model.catalogue import catalogue, load_effects
    from undertow.model.contract import check_effect

    found = load_effects(file)
    known = {**{getattr(cls, "id", ""): cls for cls in found}, **catalogue()}
    with progress("checking", float(len(found))) as report:
        results = []
        for done, cls in enumerate(found):
            report(float(done), f"checking {cls.__name__}")
            results.append((cls, check_effect(cls, known)))
    for cls, findings in results:
        _print_findings(cls, findings)
    failed = sum(not f.ok for _, findings in results for f in findings)
    complaints = "1 complaint" if failed == 1 else f"{failed} complaints"
    typer.echo(complaints if failed else "all checks passed")
    return 1 if failed else 0


@app.command()
def new(
    id: Annotated[str, typer.Argument(metavar="ID", help="Id of the new effect, such as turning_drag.")],
    diagnosis: Annotated[Path | None, _FROM] = None,
    out: Annotated[Path | None, _OUT] = None,
    force: NewForceOption = False,
) -> None:
    """Write a template for an effect of your own: from a diagnosis, or with one example term.

    With --from it has a parameter for everything that correlates with the unexplained force. It passes
    'undertow effects check' as it is, and 'undertow diagnose --effects FILE' tries it together with the
    catalogue. You have to add the cause of the force and a reference.
    """
    from undertow.errors import UndertowError
    from undertow.files import write_whole
    from undertow.identification.diagnosis.result import Diagnosis, read_diagnosis
    from undertow.identification.report.scaffold import check_id, effect_file, example, suggested

    check_id(id)
    target = out or Path(f"{id}.py")
    replaced = target.exists()
    new_file(target, force, [diagnosis] if diagnosis else [])
    if target.suffix != ".py":
        raise UndertowError(f"'{target}' does not end in .py, as the file of an effect has to: --out {id}.py")
    found = suggested(read_diagnosis(diagnosis, Diagnosis), diagnosis.name) if diagnosis else example()
    write_whole(target, effect_file(id, target.name, found))
    say(f"{'replaced' if replaced else 'wrote'} {target}")
    for term in found.terms:
        console().print(text(f"  {term.name}: {term.about}"))


# --- the list -----------------------------------------------------------------------------------
def _summary(cls: type[Effect]) -> dict[str, Any]:
    from undertow.model.effect import kind_of

    return {
        "id": cls.id,
        "family": cls.family,
        "kind": kind_of(cls),
        "about": cls.about(),
        "built_in": cls.built_in,
    }


def _listed(known: Mapping[str, type[Effect]]) -> Iterator[tuple[str, str, str]]:
    before = ""
    for cls in sorted(known.values(), key=_family_order):
        yield (cls.family if cls.family != before else "", cls.id, cls.about())
        before = cls.family


def _family_order(cls: type[Effect]) -> tuple[int, str]:
    place = _FAMILIES.index(cls.family) if cls.family in _FAMILIES else len(_FAMILIES)
    return place, cls.family


# --- one effect -----------------------------------------------------------------------------------
def _print_description(d: Description) -> None:
    out = console()
    kind = f"{d.family}, {d.kind}" if d.family != d.kind else d.kind
    out.print(text(f"{d.id} ({kind})", "bold"))
    for line in (d.about, d.details, _remarks(d)):
        if line:
            out.print(text(line))
    section("Equations", table(("",) * 3, ((e.left, "=", e.plain) for e in d.equations)))
    section("where", table(("",) * 2, d.legend.items()) if d.legend else None)
    section("LaTeX")
    for equation in d.equations:
        say(f"  {equation.latex}")
    rows = [(p.name, p.unit, _number(p.low), _number(p.high), _role(p), p.about) for p in d.parameters]
    rows += [(n, unit, "", "", "in files", "another way to write it") for n, unit in d.also_in_files.items()]
    rows += [(n, "", "", "", "from a log", about) for n, about in d.from_logs.items()]
    content = (
        table(("name", "unit", "from", "to", "", "meaning"), rows) if rows else text("  none of its own")
    )
    section("Parameters (SNAME signs)", content)
    section("In a log", text(f"  {d.signature}"))
    section("Reference", text(f"  {d.reference}"))


def _remarks(d: Description) -> str:
    remarks = [f"shares parameters of {r}" for r in d.requires]
    if d.shares:
        remarks.append(f"shares those parameters of {', '.join(d.shares)} that the vehicle has")
    remarks += [{"dissipative": "never feeds power in", "workless": "does no work"}[c] for c in d.claims]
    if d.built_in:
        remarks.append("comes with the hardware of the vehicle")
    line = "; ".join(remarks)
    return f"{line[0].upper()}{line[1:]}." if line else ""


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _role(p: ParameterNote) -> str:
    role = ("linear" if p.linear else "shape") + (", per run" if p.per_run else "")
    if p.required:
        return f"{role}, required"
    return role if p.default is None else f"{role}, else {p.default:g}"


# --- findings -------------------------------------------------------------------------------------
def _print_findings(cls: type[Effect], findings: list[ContractCheck]) -> None:
    rows = [("ok" if f.ok else text("FAIL", "bold red"), f.check, f.message) for f in findings]
    section(f"{cls.__name__}: {getattr(cls, 'id', 'no id')}", table(("",) * 3, rows))
