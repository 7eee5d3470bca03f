"""What the numbers put into the page on the roll decay of a tanker model."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.results.text import MISSING, number, percent, table

from . import tables
from .calls import Reported
from .kvlcc2 import BEST

#: model_test_parameters.csv, full scale: GM, KG, draught, radius of gyration (m), volume (m^3); the scale.
GM, KG, DRAUGHT, KXX, VOLUME, SCALE = 5.73, 18.6, 20.8, 23.2, 312653.0, 68.0
#: Stated roll inertia of the vehicle file, kg m^2.
INERTIA = 115.7
#: Height of the centre of buoyancy of a full hull over its draught.
FULL_HULL = (0.50, 0.55)
_SHOWN = {"K_p": "K_p [N m s]", "K_pabsp": "K_p|p| [N m s²]", "K_ppp": "K_ppp [N m s³]", "BM": "BM [m]"}


def blocks(n: Reported) -> dict[str, str]:
    """Tables and lists of the page, from the numbers of `kvlcc2.work`."""
    alone, speed = n["diagnoses"][:3], n["diagnoses"][3:]
    return {
        "first": first(n["by_hand"]),
        "commands": tables.commands(_commands(n), "../shared/data/kvlcc2-rolldecay-sspa"),
        "compared": tables.compared(n["compared"]),
        "regimes": tables.regimes(n["compared"]["model_test_21337"]),
        "verdicts": tables.verdicts(alone),
        "diagnoses": tables.diagnoses(alone),
        "by_hand": _by_hand(n["by_hand"]),
        "truth": _truth(n["by_hand"]),
        "speed": _at_speed(n["speed"]),
        "speed_verdicts": tables.verdicts(speed),
        "speed_diagnoses": tables.diagnoses(speed),
        "doctor": tables.doctor(n),
        "seconds": tables.seconds(n),
    }


def _commands(n: Reported) -> list[str]:
    rest = n["diagnoses"][0]["command"].removeprefix("undertow diagnose ")
    return [*tables.typed(n), f"undertow add nonlinear_restoring,quadratic_damping {rest} --out better.toml"]


def first(rows: Sequence[Reported]) -> str:
    """What the owner can do, from the models by hand."""
    before, after = (min(r["fit"] for r in rows if r["model"] == name) for name in ("linear", BEST))
    return (
        "Give this ship roll damping that grows with the rate (`quadratic_damping`) and the righting moment "
        "of vertical sides (`nonlinear_restoring`): a free run of 66 s then explains at least "
        f"{number(after)}% of the roll angle of a test that it was not fitted to, and with linear damping "
        f"alone {number(before)}%."
    )


def _by_hand(rows: Sequence[Reported]) -> str:
    head = ("identified → judged", "model", "free run explains", "5 s ahead", *_SHOWN.values())
    return table(head, [_model(r) for r in rows], left=2)


def _model(r: Reported) -> list[str]:
    return [
        r["way"],
        r["model"],
        f"{number(r['fit'])}%",
        percent(r["ahead"]),
        *(_value(r, p) for p in _SHOWN),
    ]


def _value(row: Reported, name: str) -> str:
    if name not in row:
        return MISSING
    found = row[name]
    spread = "" if found["sigma"] is None else f" ± {found['sigma']:.1g}"
    return f"{number(found['value'])}{spread}"


def _truth(rows: Sequence[Reported]) -> str:
    """Inertia and BM against what the table of the tests implies."""
    best = [r for r in rows if r["model"] == BEST]
    dry = VOLUME / SCALE**3 * 1000 * (KXX / SCALE) ** 2
    whole = " and ".join(number(INERTIA - r["K_pdot"]["value"], 4) for r in best)
    arm = " and ".join(number(SCALE * r["BM"]["value"]) for r in best)
    low, high = (GM + KG - share * DRAUGHT for share in FULL_HULL[::-1])
    return (
        f"- Inertia in roll, ship and water together: {whole} kg m² (both ways; {BEST}).\n"
        f"  The stated radius of gyration gives {number(dry, 4)} kg m²; the difference is added inertia if "
        "that radius is of\n  the dry ship, which the table does not say.\n"
        f"- BM: {arm} m in full scale. The table has no BM, but KB + BM = KG + GM = {GM + KG:.2f} m, and the "
        f"centre\n  of buoyancy of so full a hull lies at {FULL_HULL[0]:.2f} to {FULL_HULL[1]:.2f} of its "
        f"draught: that makes BM {low:.1f} to {high:.1f} m.\n"
    )


def _at_speed(rows: Sequence[Reported]) -> str:
    shown = ("K_p", "K_pabsp", "BM")
    cells = [[r["test"], r["model"], *(_value(r, p) for p in shown)] for r in rows]
    return table(("test", "model", *(_SHOWN[p] for p in shown)), cells, left=2)
