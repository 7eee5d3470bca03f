"""A gain set on its vehicle, in numbers that conditions can be evaluated on."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from undertow.control.gains import GainSet
from undertow.errors import UndertowError
from undertow.typing import Array

from .attitude import Attitudes, Certificate, least
from .case import SignSet, sign_sets
from .condition import Condition, Signs
from .declared import CONDITIONS
from .feasible import Span, where_positive

# Every 30 degrees of heading, every 20 of roll and pitch as they are unless stated.
_HEADINGS, _TILTS = 13, 7


class Problem:
    """The margins of every condition of a law.

    Parameters
    ----------
    gains : GainSet
        The law with its numbers and the plant.
    tilt : float
        Largest roll and pitch that conditions have to hold for, rad.
    """

    def __init__(self, gains: GainSet, tilt: float = np.pi / 3) -> None:
        self.gains, self.plant = gains, gains.plant
        self.coordinates = gains.signals.coordinates
        self.conditions: tuple[Condition, ...] = CONDITIONS[gains.law.id]
        self.sets: list[SignSet] = sign_sets(gains.plant)
        self.values = {
            g.name: np.array([gains.values[str(g.symbol(c))] for c in self.coordinates])
            for g in type(gains.law).gains
        }
        self.attitudes = Attitudes(gains.plant, tilt, self.same(("x", "y", "z")))

    def changed(self, values: dict[str, Array]) -> Problem:
        """The same with other gains."""
        other = object.__new__(Problem)
        other.__dict__.update(self.__dict__)
        other.values = values
        return other

    def of_forms(self, forms: Sequence[str]) -> Problem:
        """The same with the conditions of some forms only; with all where none is named."""
        other = self.changed(self.values)
        other.conditions = tuple(c for c in self.conditions if not forms or c.form in forms)
        if not other.conditions:
            raise UndertowError(
                f"law '{self.gains.law.id}' has no conditions of the form {' or '.join(forms)}: it has "
                f"{' and '.join(dict.fromkeys(c.form for c in self.conditions))}"
            )
        return other

    @property
    def size(self) -> int:
        """Number of pose coordinates."""
        return len(self.coordinates)

    @property
    def driven(self) -> list[int]:
        """Coordinates that the law drives: axes left alone have gains only if the file states them."""
        return [i for i in range(self.size) if all(v[i] for v in self.values.values())]

    @cached_property
    def distinct(self) -> list[SignSet]:
        """The sign sets that matter: with diagonal matrices the mixed ones add nothing to the first two."""
        return self.sets[:2] if self.decoupled else self.sets

    @cached_property
    def decoupled(self) -> bool:
        """Whether M and D are diagonal, so that every axis is a channel of its own at rest."""
        matrices = [m for one in self.sets for m in (one.inertia, one.damping)]
        return all(np.array_equal(m, np.diag(np.diag(m))) for m in matrices)

    @property
    def turned(self) -> bool:
        """Whether no gain tells north from east, so that the heading changes no eigenvalue."""
        return self.same(("x", "y")) or not {"x", "y"} & set(self.coordinates)

    @property
    def heading_counts(self) -> bool:
        """Whether the loop at rest can differ between headings: gains tell north from east, and it turns."""
        return not self.turned and {"x", "y", "psi"} <= set(self.coordinates)

    @property
    def headings(self) -> list[tuple[float, Array]]:
        """Headings to try, degrees, with J on an even keel; the loop at rest repeats after half a turn."""
        if not self.heading_counts:
            return [(0.0, inverse_of(self.attitudes.at({})))]
        degrees = map(float, range(0, 180, 10))
        return [(d, inverse_of(self.attitudes.at({"psi": float(np.radians(d))}))) for d in degrees]

    @property
    def channels(self) -> list[tuple[int, int, str]]:
        """Coordinate, axis and name of each channel; x and y change axes for a vehicle that heads east."""
        own = [(i, i, self.coordinates[i]) for i in self.driven]
        if not self.heading_counts:
            return own
        x, y = (self.coordinates.index(c) for c in ("x", "y"))
        return [*own, (x, y, "x heading east"), (y, x, "y heading east")]

    def same(self, coordinates: tuple[str, ...]) -> bool:
        """Whether the vehicle has these coordinates, and every gain is the same for all of them."""
        if not set(coordinates) <= set(self.coordinates):
            return False
        places = [self.coordinates.index(c) for c in coordinates]
        return all(len({float(v[i]) for i in places}) == 1 for v in self.values.values())

    @cached_property
    def sampled(self) -> list[tuple[dict[str, float], Array]]:
        """Attitudes spread over the range with J^-1, to choose iota by and to estimate the region at."""
        angles = self.attitudes.angles(self.turned)
        if not angles or (self.attitudes.orthogonal and self.turned):
            return [({}, self.attitudes.at({}))]
        pairs = zip(angles, self.attitudes.box(angles), strict=True)
        axes = [np.linspace(low, high, _HEADINGS if a == "psi" else _TILTS) for a, (low, high) in pairs]
        rows = np.stack([g.ravel() for g in np.meshgrid(*axes)], axis=1)
        points = [dict(zip(angles, map(float, row), strict=True)) for row in rows]
        return [(point, self.attitudes.at(point)) for point in points]

    @cached_property
    def _samples(self) -> Array:
        return np.array([inverse for _, inverse in self.sampled])

    @property
    def few_attitudes(self) -> Array:
        """Some attitudes for what has to be tried with many parameters, shape (k, n, n)."""
        return self._samples[:: max(1, len(self._samples) // 8)]

    # --- margins ------------------------------------------------------------------------------
    def signs(self, one: SignSet, inverse: Any, iota: float | None, theta: Array | None = None) -> Signs:
        """All quantities in the pose coordinates that are driven, for J^-1 as numbers or intervals."""
        theta = one.theta if theta is None else theta
        own = self.driven
        gains = {name: np.diag(v[own]) for name, v in self.values.items()}
        columns = inverse[..., own] if isinstance(inverse, np.ndarray) else inverse.columns(own)
        turn = columns.T if not isinstance(columns, np.ndarray) else np.swapaxes(columns, -1, -2)
        M, D = (turn @ m.at(theta) @ columns for m in (one.M, one.D))
        return Signs({**gains, "M": M, "D": D, "iota": iota})

    def channel_signs(
        self, one: SignSet, i: int, iota: Any, theta: Array | None = None, axis: int | None = None
    ) -> Signs:
        """The quantities of one channel at rest on an even keel, shape (..., 1, 1).

        A coordinate acts on its own axis (heading north) unless another one is given.
        """
        theta = one.theta if theta is None else theta
        k = i if axis is None else axis
        gains = {name: v[i].reshape(1, 1) for name, v in self.values.items()}
        M, D = (m.at(theta)[..., k : k + 1, k : k + 1] for m in (one.M, one.D))
        return Signs({**gains, "M": M, "D": D, "iota": iota})

    def margin(
        self, condition: Condition, one: SignSet, iota: float | None, theta: Array | None = None
    ) -> float:
        """Margin of a condition as matrices, the least over some attitudes."""
        if theta is None:
            return float(np.min(condition.margin(self.signs(one, self._samples, iota))))
        return float(np.min([condition.margin(self.signs(one, J, iota, theta)) for J in self._samples]))

    def channel_margin(
        self, condition: Condition, one: SignSet, i: int, iota: float | None, theta: Array | None = None
    ) -> float:
        """Margin of a condition for one channel."""
        return float(np.min(condition.margin(self.channel_signs(one, i, iota, theta))))

    def certificate(self, condition: Condition, one: SignSet, iota: float | None) -> Certificate:
        """The margin over all attitudes with its proof."""

        def margins(inverse: Any) -> Array:
            count = len(inverse) if isinstance(inverse, np.ndarray) else len(inverse.lo)
            return np.broadcast_to(condition.margin(self.signs(one, inverse, iota)), count)

        return least(margins, self.attitudes, self.turned, bool(condition.uses))

    # --- iota ---------------------------------------------------------------------------------
    def iota(
        self, conditions: list[Condition], sets: list[SignSet], channel: int | None = None
    ) -> Span | None:
        """The values of iota for which conditions hold together in all of these sets, or None."""

        def together(iota: float) -> float:
            if channel is None:
                return min(self.margin(c, one, iota) for c in conditions for one in sets)
            return min(self.channel_margin(c, one, channel, iota) for c in conditions for one in sets)

        return where_positive(together)


def inverse_of(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=float)
