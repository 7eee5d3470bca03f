"""Body velocities for logs that have only pose (motion capture, long baseline, camera)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.frames import to_body
from undertow.identification.logs.run import POSE, UNITS, VELOCITY, Run
from undertow.identification.logs.tracks import LOST, Track, track
from undertow.typing import Array

_DOF = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_FEWEST = 10  # samples of a pose channel
_STILL = 1e-9  # change of a channel, as a share of its size, that is rounding


def velocities_from_pose(run: Run, degrees_of_freedom: Iterable[str] = ("surge", "sway", "yaw")) -> Run:
    """Add the body velocities that a run lacks, from its pose.

    Each pose channel is smoothed (see `undertow.identification.logs.tracks`): noise and smoothness are
    estimated from the data, outliers are dropped, shifts of the origin are bridged, and where tracking was
    lost for more than 0.5 s the velocities are NaN. Roll and pitch take part where they are degrees of
    freedom, and are taken as zero otherwise.

    Parameters
    ----------
    run : Run
        With the pose channels of the degrees of freedom; x and y need psi beside them unless the heading is
        constant.
    degrees_of_freedom : iterable of str
        Of ``surge sway heave roll pitch yaw``.

    Returns
    -------
    Run
        With u … r (m/s, rad/s, body axes) of the degrees of freedom; their names are in `derived` and the
        medians of their standard deviations in `sigma`. Velocities that were there are kept; outliers in the
        pose are NaN.

    Raises
    ------
    UndertowError
        If a pose channel is missing, or has too few samples.
    """
    asked = list(degrees_of_freedom)
    lacking = [VELOCITY[_DOF.index(name)] for name in asked if not run.has(VELOCITY[_DOF.index(name)])]
    if not lacking:
        return run
    tracks = {name: _tracked(run, name) for name in _pose_needed(run, asked)}
    rates, spread = _body_rates(run, tracks)
    pose = {name: np.where(one.outlier, np.nan, run.channels[name]) for name, one in tracks.items()}
    found = {name: rates[VELOCITY.index(name)] for name in lacking}
    sigma = {name: float(np.nanmedian(spread[VELOCITY.index(name)])) for name in lacking}
    return replace(
        run,
        channels={**run.channels, **pose, **found},
        sigma={**run.sigma, **sigma},
        derived=run.derived | set(lacking),
        resolution=max((tracks[n].resolution for n in tracks if _moves(run.channels[n])), default=0.0),
    ).noted(_summary(tracks, sigma), *(_told(run, name, one) for name, one in tracks.items()))


def _pose_needed(run: Run, asked: list[str]) -> list[str]:
    needed = {POSE[_DOF.index(name)] for name in asked}
    # A vehicle that only surges along x, say a towed hull, may do without a heading; with one, x and y are
    # turned by it.
    if needed & {"x", "y"} and ("psi" in needed or all(run.has(name) for name in ("x", "y", "psi"))):
        needed |= {"x", "y", "psi"}
    missing = [name for name in POSE if name in needed and not run.has(name)]
    if missing:
        raise UndertowError(
            f"run {run.name!r} has neither the velocities nor the pose {', '.join(missing)} for "
            f"{', '.join(asked)}: "
            "map these columns, or leave the degrees of freedom out of the vehicle"
        )
    return [name for name in POSE if name in needed]


def _tracked(run: Run, name: str) -> Track:
    count = int(np.isfinite(run.channels[name]).sum())
    if count < _FEWEST:
        raise UndertowError(
            f"run {run.name!r}: channel {name!r} has {count} samples, at least {_FEWEST} are needed to take "
            "a velocity "
            "from it: give a longer log"
        )
    try:
        return track(run.t, run.channels[name])
    except ValueError as error:
        raise UndertowError(f"run {run.name!r}: no velocity from channel {name!r}: {error}") from error


def _moves(channel: Array) -> bool:
    """Whether a channel changes; one that does not is smoothed without end, and hides no motion."""
    size = float(np.nanmax(np.abs(channel)))
    return bool(np.nanmax(channel) - np.nanmin(channel) > _STILL * max(size, 1.0))


def _body_rates(run: Run, tracks: dict[str, Track]) -> tuple[Array, Array]:
    """Return u … r and their standard deviations, (6, n) each; what was not tracked counts as zero."""
    zero = np.zeros(len(run.t))
    value, value_var, rate, rate_var = (
        np.array([function(tracks[name]) if name in tracks else zero for name in POSE])
        for function in (
            lambda one: one.value,
            lambda one: one.value_sd**2,
            lambda one: one.rate,
            lambda one: one.rate_sd**2,
        )
    )
    rotation, euler = _to_body(*value[3:])
    linear, angular = np.einsum("ijn,jn->in", rotation, rate[:3]), np.einsum("ijn,jn->in", euler, rate[3:])
    # An attitude error turns the velocity: velocity x error.
    turned = [(linear[(i + 1) % 3] ** 2 * value_var[3 + (i + 2) % 3]) for i in range(3)]
    turned = [one + linear[(i + 2) % 3] ** 2 * value_var[3 + (i + 1) % 3] for i, one in enumerate(turned)]
    linear_var = np.einsum("ijn,jn->in", rotation**2, rate_var[:3]) + turned
    angular_var = np.einsum("ijn,jn->in", euler**2, rate_var[3:])
    return np.concatenate([linear, angular]), np.sqrt(np.concatenate([linear_var, angular_var]))


def _to_body(phi: Array, theta: Array, psi: Array) -> tuple[Array, Array]:
    """Return R^T (NED to body) and T^-1 (Euler to body rates), (3, 3, n) each (Fossen 2021, section 2.2)."""
    (cf, sf), (ct, st) = ((np.cos(angle), np.sin(angle)) for angle in (phi, theta))
    one, zero = np.ones_like(phi), np.zeros_like(phi)
    euler = np.array([[one, zero, -st], [zero, cf, ct * sf], [zero, -sf, ct * cf]])
    return to_body(phi, theta, psi), euler


def _summary(tracks: dict[str, Track], sigma: dict[str, float]) -> str:
    accuracy = ", ".join(f"{name} +- {value:.2g} {UNITS[name]}" for name, value in sigma.items())
    return f"velocities from pose {', '.join(tracks)} by a Kalman smoother: {accuracy} (median)"


def _told(run: Run, name: str, one: Track) -> str:
    parts = [f"{name}: noise {one.noise:.2g} {UNITS[name]}"]
    if one.outlier.any():
        parts.append(f"{one.outlier.sum()} outliers dropped ({_times(run.t[one.outlier])})")
    if one.jump.any():
        at = np.flatnonzero(one.jump)
        largest = np.nanmax(np.abs(one.value[at] - one.value[at - 1]))
        parts.append(f"{len(at)} shifts of up to {largest:.2g} {UNITS[name]} bridged ({_times(run.t[at])})")
    if one.lost:
        spells = ", ".join(f"{start:g}-{stop:g}" for start, stop in one.lost)
        parts.append(f"not tracked for more than {LOST:g} s at t = {spells} s, no velocity there")
    return "; ".join(parts)


def _times(t: Array, most: int = 6) -> str:
    return "t = " + ", ".join(f"{time:g}" for time in t[:most]) + (" … s" if len(t) > most else " s")
