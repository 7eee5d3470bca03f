"""The box hull in a flow solver, estimated by the paper's chain and by the others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import Fitted, verdicts
from undertow.identification.estimation.output_error import fit_output_error
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle
from undertow.paper.least_squares import estimate, experiments, selected
from undertow.paper.regression import CASES

LOGS = ("surge_step_coarse_dt0p2.csv", "surge_multistep_coarse_dt0p2.csv")
BODY = 60.48
_NAMES = ("X_udot", "X_u", "X_uabsu")


@dataclass(frozen=True)
class Estimate:
    """What one method makes of one log.

    Attributes
    ----------
    log, method : str
        Which.
    values, errors : tuple of float
        m_x, X_u, X_u|u| as magnitudes, and their standard errors.
    known : tuple of str
        Verdict on each, where the method gives one.
    """

    log: str
    method: str
    values: tuple[float, ...]
    errors: tuple[float, ...]
    known: tuple[str, ...]


def estimates(data: Path) -> list[Estimate]:
    """All methods on both force profiles."""
    stated = load_vehicle("box-hull")
    # Without the stated priors, which would hold the added mass.
    free = stated.with_values({n: Value(stated.value_of(n).value, estimate=True) for n in _NAMES})
    mapping = read_mapping(Path(__file__).with_name("cfd.toml"))
    return [e for log in LOGS for e in _of(free, read_log(data / log, mapping, ["tau_X"]))]


def _of(vehicle: Vehicle, run: Run) -> list[Estimate]:
    (surge,) = experiments(vehicle, [run])
    tried = {name: estimate(surge, case) for name, case in CASES.items()}
    pick = selected(list(tried.values()))
    chain = [tried[n] for n in dict.fromkeys(["1", "11", *([pick.case.name] if pick else [])])]
    ruled = {id(pick): ", by the rule"}
    found = [
        _estimate(run, f"case {e.case.name}{ruled.get(id(e), '')}", e.values, e.standard_errors, ())
        for e in chain
    ]
    bare = Run(run.name, run.t, {n: run.channels[n] for n in ("x", "u", "tau_X")})
    fits: dict[str, Fitted] = {"weak form": fit_weak(vehicle, prepare([bare], vehicle))}
    fits["output error"] = fit_output_error(vehicle, [bare], horizon=None)
    for method, fit in fits.items():
        known = verdicts(fit)
        found.append(_estimate(run, method, fit.values, fit.standard_errors, tuple(known[n] for n in _NAMES)))
    return found


def _estimate(
    run: Run, method: str, values: dict[str, float], errors: dict[str, float], known: tuple[str, ...]
) -> Estimate:
    body = (BODY, 0.0, 0.0)
    numbers = tuple(b - values[n] for b, n in zip(body, _NAMES, strict=True))
    return Estimate(run.name, method, numbers, tuple(errors[n] for n in _NAMES), known)
