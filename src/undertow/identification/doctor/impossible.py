"""What cannot be, whatever the physics: forces and speeds that no vehicle of this mass has.

Pose rates against velocities tell most mistakes in units, but not where both are wrong alike, or where only
one of them was measured, or in commands. There, mass, thrust and size of the vehicle tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Mapping, Run
from .command_mistakes import other_units
from .dynamics import rederived
from .kinematics import Kinematics
from .mending import Edits, column_edit
from .mistake import SETTINGS, Mistake, Settings, scaling
from .reading_mistakes import RATES, reading_mistakes
from .responses import Response, Responses
from .units import SPEEDS, UNITS_OF_MOTION, likely_time_units


@dataclass(frozen=True)
class Impossible:
    """A mistake without which a log cannot be.

    Attributes
    ----------
    mistake : Mistake
        The likeliest.
    rivals : list of Mistake
        Others that would make it possible.
    why : str
        Value and limit, in words.
    evidence : dict
        The same in numbers, SI.
    """

    mistake: Mistake
    rivals: list[Mistake]
    why: str
    evidence: dict[str, float]


def suspicious(
    vehicle: Vehicle, runs: Sequence[Run], mapping: Mapping, kinematics: Kinematics
) -> Impossible | None:
    """A motion that needs a few times the force commanded, as it would in another unit; None where none does.

    Parameters are those of `impossible`. Lags and dead times make a motion need less, never more.
    """
    milder = replace(SETTINGS, strongest=SETTINGS.doubtful, near=SETTINGS.alike)
    return _Look(vehicle, list(runs), mapping, kinematics, milder).by_force()


def impossible(
    vehicle: Vehicle,
    runs: Sequence[Run],
    mapping: Mapping,
    kinematics: Kinematics,
    settings: Settings = SETTINGS,
) -> Impossible | None:
    """What in logs no vehicle of this mass, thrust and size can do; None where there is nothing.

    Parameters
    ----------
    vehicle : Vehicle
        Mass, thrusters and their limits.
    runs : sequence of Run
        Logs whose pose rates and velocities do not contradict each other, as far as both were measured.
    mapping : Mapping
        How they were read.
    kinematics : Kinematics
        What pose rates and velocities allow.
    settings : Settings
        From where on something cannot be.
    """
    look = _Look(vehicle, list(runs), mapping, kinematics, settings)
    return look.by_force() or look.by_size() or look.by_limits()


_Known = dict[tuple[str, str], Response]
"""Responses by motion and command."""


@dataclass(frozen=True)
class _Look:
    vehicle: Vehicle
    runs: list[Run]
    mapping: Mapping
    kinematics: Kinematics
    settings: Settings

    # --- force -----------------------------------------------------------------------------------
    def by_force(self) -> Impossible | None:
        """The force that the motion needs, against what the commands give."""
        try:
            responses = Responses(self.vehicle, self.settings)
        except UndertowError:  # actuation that depends on the motion cannot be told from the log alone
            return None
        before = self._sure(responses.of(self.runs))
        far = {key: r for key, r in before.items() if not self._possible(r)}
        if not far:
            return None
        worst = max(far.values(), key=lambda r: abs(np.log(abs(r.gain))))
        found = self._explaining(responses, before, far)
        if not found:
            return None
        return Impossible(found[0], found[1:], _force_text(worst, self.settings), _force_evidence(worst))

    def _sure(self, found: Sequence[Response]) -> _Known:
        s = self.settings
        return {(r.degree_of_freedom, r.command): r for r in found if r.sure(s.errors, s.share)}

    def _explaining(
        self,
        responses: Responses,
        before: _Known,
        far: _Known,
    ) -> list[Mistake]:
        """Mistakes without which force and motion agree, the simplest first, then the best."""
        found = []
        for place, mistake in enumerate([*self._readings(), *self._commands(far)]):
            all_after = responses.of(self._without(mistake))
            after = self._sure(all_after)
            # What could be seen before must still be: else a motion that is scaled away agrees with anything.
            if all(key in after for key in before) and self._agree(far, after) and self._allowed(mistake):
                score = float(np.mean([abs(np.log(abs(after[key].gain))) for key in before]))
                seen = sum(r.sure(self.settings.errors / 2, 0.0) for r in all_after)
                found.append(((mistake.count, -seen, round(score, 1), place), mistake))
        return [mistake for _, mistake in sorted(found, key=lambda pair: pair[0])]

    def _possible(self, r: Response) -> bool:
        return self.settings.weakest < abs(r.gain) < self.settings.strongest

    def _agree(self, far: _Known, after: _Known) -> bool:
        near = all(_within(after[key].gain, self.settings.near) for key in far)
        return near and all(map(self._possible, after.values()))

    def _without(self, mistake: Mistake) -> list[Run]:
        return [rederived(run, mistake.undo) for run in self.runs]

    def _allowed(self, mistake: Mistake) -> bool:
        """Whether pose rates and velocities agree as well without a mistake as with it."""
        if not self.kinematics:
            return True
        given = self.kinematics.mismatch(self.runs).total
        return self.kinematics.mismatch(self._without(mistake)).total < 1.25 * given + 0.01

    def _readings(self) -> Iterator[Mistake]:
        """Units of what was measured."""
        # Pose rates have been held against velocities: with them the clock was.
        yield from () if self.kinematics else likely_time_units(self.runs, self.mapping)
        known = reading_mistakes(self.mapping, self.runs)
        yield from (m for m in known if m.id in UNITS_OF_MOTION or "degrees" in m.id)

    def _commands(self, far: _Known) -> Iterator[Mistake]:
        """Units of commands: those that are known, one command, or all of them times a factor."""
        yield from other_units(self.vehicle, self.runs)
        by_name: dict[str, list[float]] = {}
        for (_, name), r in far.items():
            by_name.setdefault(name, []).append(r.gain)
        factors = {name: float(np.median(np.abs(gains))) for name, gains in by_name.items()}
        one = {(name,): factor for name, factor in factors.items() if name}
        everything = {self.vehicle.command_names: float(np.median([*factors.values()]))}
        for names, factor in (one | everything).items():
            if _within(factor, self.settings.command):
                yield times(names, factor)

    # --- size ------------------------------------------------------------------------------------
    def by_size(self) -> Impossible | None:
        """Speeds that a vehicle of this size does not reach."""
        known = self.vehicle.values.get("m")
        if known is None or known.estimate or not known.value > 0:
            return None
        rho, g = (self.vehicle.environment[n] for n in ("rho", "g"))
        size, s = float(np.cbrt(known.value / rho)), self.settings
        speed = float(np.clip(s.froude * np.sqrt(g * size), s.slowest, s.fastest))
        limits = {SPEEDS: speed, RATES: float(np.sqrt(s.turning * g / size))}
        for names, limit in limits.items():
            if (fastest := self._fastest(self.runs, names)) > limit:
                return self._too_fast(names, fastest, limit, known.value)
        return None

    def _fastest(self, runs: Sequence[Run], names: tuple[str, ...]) -> float:
        """Speed, or rate of turn, that a twentieth of the samples exceed."""
        own = [n for n in names if n in self.vehicle.velocity_names]
        if not own:
            return 0.0
        total = np.concatenate([np.sqrt(np.sum(run.matrix(own) ** 2, axis=1)) for run in runs])
        present = total[np.isfinite(total)]
        return float(np.quantile(present, 0.95)) if len(present) else 0.0

    def _too_fast(self, names: tuple[str, ...], value: float, limit: float, mass: float) -> Impossible | None:
        units = (m for m in self._readings() if self._fastest(self._without(m), names) <= limit)
        found = [m for m in units if self._allowed(m)]
        if not found:
            return None
        unit = "m/s" if names == SPEEDS else "rad/s"
        own = ", ".join(n for n in names if n in self.vehicle.velocity_names)
        why = f"{own} reach {value:.3g} {unit}, and no vehicle of {mass:.4g} kg exceeds {limit:.3g} {unit}"
        return Impossible(found[0], found[1:], why, {"value": value, "limit": limit})

    # --- limits of the commands ------------------------------------------------------------------
    def by_limits(self) -> Impossible | None:
        """Commands far beyond what the vehicle file has as the largest."""
        limits = {t.name: t.limit for t in self.vehicle.thrusters if t.limit}
        beyond = {n: _rms(self.runs, n) / limit for n, limit in limits.items()}
        far = {n: ratio for n, ratio in beyond.items() if ratio > self.settings.limit}
        if not far:
            return None
        worst = max(far, key=lambda n: far[n])
        known = [m for m in other_units(self.vehicle, self.runs) if _brings_within(m, self.runs, limits)]
        mistake = known[0] if known else times(tuple(far), float(1.0 / np.median([*far.values()])))
        value, limit = far[worst] * limits[worst], limits[worst]
        why = f"{worst} is {value:.4g} rms, and its limit in the vehicle file is {limit:.4g}"
        return Impossible(mistake, known[1:], why, {"value": value, "limit": limit})


def _within(gain: float, factor: float) -> bool:
    return 1.0 / factor < abs(gain) < factor


def _rms(runs: Sequence[Run], name: str) -> float:
    data = np.concatenate([run.channels[name] for run in runs])
    present: Array = data[np.isfinite(data)]
    return float(np.sqrt(np.mean(present**2))) if len(present) else 0.0


def _brings_within(mistake: Mistake, runs: Sequence[Run], limits: dict[str, float]) -> bool:
    undone = [mistake.undo(run) for run in runs]
    return all(_rms(undone, n) <= 1.5 * limit for n, limit in limits.items())


def times(names: tuple[str, ...], found: float) -> Mistake:
    """Commands that count a factor too much or too little; near a power of ten it is one."""
    ten = 10.0 ** round(np.log10(found))
    factor = ten if max(found / ten, ten / found) < 2.5 else float(f"{found:.2g}")

    def edits(m: Mapping) -> Edits:
        return tuple(column_edit(m, n, times=factor) for n in names)

    verb = "command {} is" if len(names) == 1 else "commands {} are"
    size = f"{1 / factor:.4g} times too large" if factor < 1 else f"{factor:.4g} times too small"
    told = f"{verb.format(', '.join(names))} {size}"
    # It explains whatever one of the known units would, which comes first.
    return Mistake("command_unit", told, scaling(dict.fromkeys(names, factor)), edits, 1 + len(names))


def _force_text(r: Response, settings: Settings) -> str:
    what = f"command {r.command} gives" if r.command else "the commands give"
    unit = "N" if r.degree_of_freedom in ("surge", "sway", "heave") else "N m"
    if abs(r.gain) > 1:
        ratio, limit = f"{abs(r.gain):.3g} times what {what}", f"at most {settings.strongest:g}"
    else:
        ratio = f"{abs(r.gain):.3g} of what {what}"
        limit = f"at least {settings.weakest:g}"
    forces = f"{r.needed:.3g} {unit} against {r.given:.3g} {unit} rms"
    return f"the {r.degree_of_freedom} of the log needs {ratio} ({forces}; {limit} can be)"


def _force_evidence(r: Response) -> dict[str, float]:
    return {"gain": r.gain, "error": r.error, "needed": r.needed, "given": r.given}
