"""C/S Enterprise I, all free-running logs: by joystick, under dynamic positioning, and in waves."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import medfilt, welch

from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run

from . import tables
from .calls import ROOT, Caller, Judged, Reported
from .variants import Tables, variant, vehicle_of

Array = NDArray[np.float64]
FOLDER = "ntnu-cse1/freerun"
VEHICLE = "examples/cse1/vehicle.toml"
MAPPING = "examples/cse1/log.toml"
RUN_1, RANDOM_1, RANDOM_3 = "manual_run1.csv", "manual_random_run1.csv", "manual_random_run3.csv"
DP_1, DP_2, DP_3 = "dp_dptest1.csv", "dp_dptest2.csv", "dp_dptest3_waves.csv"
Window = tuple[float | None, float | None]
WHOLE: Window = (None, None)
#: Both ships were under dynamic positioning all the time with their propellers at one speed.
POSITIONING: Window = (375.0, 645.0)
#: dptest2 in calm water, dptest3 in waves, both under dynamic positioning.
WAVES: Window = (275.0, 394.0)
#: Of dptest3: before the waves, and in them.
CALM_PART, WAVE_PART = (60.0, 225.0), (235.0, 394.0)
_BAND, _DELAY = {"thruster_deadband": {"deadband_width": 0.1}}, {"actuation_delay": {"delay": 0.25}}
_CURVE = {"thruster_curve": {"curve_square": 0.0}}
#: Models fitted by hand: what the bollard tests of the propellers show, and a delay found by hand.
MODELS: dict[str, Tables] = {
    "model": {},
    "+ delay": _DELAY,
    "+ dead band": _BAND,
    "+ dead band + delay": {**_BAND, **_DELAY},
    "+ curve": _CURVE,
    "+ curve + delay": {**_CURVE, **_DELAY},
}
#: The best of them by joystick, both ways.
CURVED = "+ curve + delay"
#: Frequencies of waves and roll, Hz.
BAND = (0.5, 1.5)
CHANNELS = {"z": "m", "phi": "rad", "theta": "rad", "x": "m", "y": "m", "psi": "rad"}


def both(one: str, other: str, window: Window, why: str) -> tuple[Judged, Judged]:
    """Identify on one log and judge on the other, and the other way round."""
    pairs = ((one, other), (other, one))
    return tuple(  # type: ignore[return-value]
        Judged(f"{a[:-4]} → {b[:-4]} ({why})", VEHICLE, MAPPING, (a,), (b,), window) for a, b in pairs
    )


WAYS = (
    *both(RANDOM_1, RANDOM_3, WHOLE, "joystick, propellers at 0.4"),
    *both(RANDOM_1, RUN_1, WHOLE, "joystick, propellers at 0.4 and 0.3"),
    *both(DP_1, DP_2, POSITIONING, "positioning, calm"),
    *both(RANDOM_1, DP_1, POSITIONING, "joystick and positioning"),
    *both(DP_2, DP_3, WAVES, "positioning, calm and waves"),
)
HAND_WAYS = (*WAYS[:2], *WAYS[4:6])
COMPARED: dict[str, tuple[str, Window]] = {
    "manual_run1": (RUN_1, (20.0, 223.0)),
    "manual_random_run1": (RANDOM_1, (45.0, 700.0)),
    "manual_random_run3": (RANDOM_3, (21.0, 360.0)),
    "dp_dptest1": (DP_1, POSITIONING),
    "dp_dptest2": (DP_2, POSITIONING),
    "dp_dptest3_waves, calm part": (DP_3, CALM_PART),
    "dp_dptest3_waves, in waves": (DP_3, WAVE_PART),
}


def work(call: Caller, images: Path) -> Reported:
    """Everything that takes time."""
    logs = {
        name: Judged("", VEHICLE, MAPPING, (log,), (), window) for name, (log, window) in COMPARED.items()
    }
    compared = {name: tables.comparison_kept(call.compare(what)) for name, what in logs.items()}
    hand = [by_hand(call, way, name) for way in HAND_WAYS for name in MODELS]
    found = [call.diagnose(way) for way in WAYS]
    spectra = {name: spectrum(read(call.data, DP_3, window)) for name, window in PARTS.items()}
    from . import cse1_pictures

    cse1_pictures.draw(call, [vehicle for _, vehicle in found], images)
    return {
        "compared": compared,
        "diagnoses": [tables.diagnosis_kept(reported) for reported, _ in found],
        "by_hand": tables.rounded(hand),
        "waves": tables.rounded({name: bands(s) for name, s in spectra.items()}),
    }


PARTS = {"calm": CALM_PART, "waves": WAVE_PART}


def by_hand(call: Caller, way: Judged, name: str) -> Reported:
    """A model with effects of one's choice, fitted (`undertow fit`) and judged on the other log."""
    file = variant(VEHICLE, MODELS[name], call.scratch / "by-hand.toml")
    fitted = call.fit(replace(way, vehicle=str(file)))
    ahead = tomllib.loads(fitted.read_text(encoding="utf-8"))["history"][-1]["error_after"]
    after = vehicle_of(fitted).values
    values = {n: [after[n].value, after[n].sigma] for table in MODELS[name].values() for n in table}
    return {"way": way.title, "model": name, "ahead": ahead, "values": values}


# --- waves ------------------------------------------------------------------------------------
def read(data: Path, log: str, window: Window) -> Run:
    """A log with its pose as measured."""
    return read_log(data / log, read_mapping(ROOT / MAPPING), ["u1", "u2", "u3", "u4", "u5"], window=window)


def spectrum(run: Run) -> dict[str, tuple[Array, Array]]:
    """Frequencies (Hz) and power density of every pose channel, outliers and short gaps bridged."""
    rate = 1.0 / float(np.median(np.diff(run.t)))
    return {
        name: welch(_whole(run.channels[name]), rate, nperseg=1024, detrend="linear") for name in CHANNELS
    }


def _whole(values: Array) -> Array:
    known = np.flatnonzero(np.isfinite(values))
    whole = np.interp(np.arange(len(values)), known, values[known])
    smooth = medfilt(whole, 5)
    spread = 1.4826 * np.median(np.abs(whole - smooth)) + 1e-6
    return np.where(np.abs(whole - smooth) > 10 * spread, smooth, whole)


def bands(spectra: dict[str, tuple[Array, Array]]) -> Reported:
    """Rms motion in the band of waves and roll, and the frequency of its peak."""
    found = {}
    for name, (frequency, density) in spectra.items():
        inside = (frequency >= BAND[0]) & (frequency <= BAND[1])
        power = float(np.sum(density[inside]) * (frequency[1] - frequency[0]))
        peak = float(frequency[inside][np.argmax(density[inside])])
        found[name] = {"rms": float(np.sqrt(power)), "peak": peak, "unit": CHANNELS[name]}
    return found
