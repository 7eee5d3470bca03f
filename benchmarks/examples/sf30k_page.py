"""What the numbers put into the page on the SUB-fighter 30k."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.results.text import MISSING, number, percent, table

from . import tables
from .calls import Reported
from .sf30k import DOPPLER_LOG, SECOND, STEADY
from .variants import added

_ARM = "velocity_lever_arm"


def blocks(n: Reported) -> dict[str, str]:
    """Tables and lists of the page, from the numbers of `sf30k.work`."""
    found, compared = n["diagnoses"], n["compared"]
    return {
        "first": first(n),
        "commands": tables.commands(tables.typed(n), "../shared/data/ntnu-rov-sf30k"),
        "compared_six": tables.compared({"six": compared["six"]}),
        "compared_four": tables.compared({"four": compared["four"]}),
        "regimes": tables.regimes(compared["four"]),
        "verdicts": tables.verdicts(found[:2]),
        "diagnoses": tables.diagnoses(found[:2]),
        "tables": f"```toml\n{added(SECOND)}```\n",
        "second_verdicts": tables.verdicts(found[2:]),
        "second_diagnoses": tables.diagnoses(found[2:]),
        "by_hand": _by_hand(n["by_hand"]),
        "doppler": _doppler(n),
        "thrust": _thrust(n["checks"]["slopes"]),
        "doctor": tables.doctor(n),
        "seconds": tables.seconds(n),
    }


def first(n: Reported) -> str:
    """What the owner can do, from the published model and the last of those by hand."""
    published, last = n["compared"]["four"]["prediction_error"], n["by_hand"][-1]["ahead"]
    return (
        "Weigh this vehicle in water, put its Doppler log where it is published to be, and step one thruster "
        f"at a time before you use the published model: 5 s ahead it is off by {percent(published)} of the "
        f"velocities, and with buoyancy, thruster gains and a loss in reverse fitted by {percent(last)}, on "
        "stretches that were not fitted."
    )


def _doppler(n: Reported) -> str:
    """Where the Doppler log is, by the diagnoses, by kinematics, and as published."""
    places = [(f"diagnosis, {d['title']}", arm_in(d)) for d in n["diagnoses"][:2]]
    places.append(("Doppler log against position fixes", n["checks"]["arm"]))
    rows = [[name, *(_cell(found.get(p)) for p in DOPPLER_LOG)] for name, found in places]
    rows.append(["published", *(f"{place:g}" for place in DOPPLER_LOG.values())])
    return table(("place of the Doppler log", "forward [m]", "to starboard [m]", "down [m]"), rows)


def arm_in(d: Reported) -> Reported:
    """The lever arm among the final parameters of a diagnosis, else as the candidate alone has it."""
    final = {p["name"]: p for p in d["parameters"] if p["effect"] == _ARM}
    alone = [r for r in d["ranking"] if r["effect"] == _ARM]
    return final or {p["name"]: p for r in alone for p in r["parameters"]}


def _cell(p: Reported | None) -> str:
    return MISSING if p is None else f"{p['value']:.2f} ± {p['standard_error']:.2f}"


def _by_hand(models: Sequence[Reported]) -> str:
    """Fitted parameters beside what is published, in SNAME signs."""
    names = dict.fromkeys(n for m in models for n in m["values"])
    rows = [[n, _stated(n, models), *(_found(m["values"].get(n)) for m in models)] for n in names]
    rows.append(["5 s ahead", "", *(percent(m["ahead"]) for m in models)])
    return table(("SI, SNAME signs", "stated", *(m["model"] for m in models)), rows)


def _stated(name: str, models: Sequence[Reported]) -> str:
    return next(number(m["values"][name][0], 4) for m in models if name in m["values"])


def _found(entry: Sequence[float] | None) -> str:
    if entry is None:
        return MISSING
    _, value, sigma = entry
    return f"{number(value)} ± {sigma:.1g}" if sigma is not None else number(value)


def _thrust(slopes: Reported) -> str:
    sides = ("all", "positive", "negative")
    rows = [[dof, *(_cell(s.get(side)) for side in sides)] for dof, s in slopes.items()]
    head = ("needed over commanded", "all", "ahead, to starboard, down", "astern, to port, up")
    return (
        f"Means over {STEADY:g} s, where inertia hardly counts: slope of the force that the motion needs\n"
        "by the published model over the force that is commanded. 1 means that all of it arrives and drag\n"
        "is as published.\n\n" + table(head, rows)
    )
