"""Line-of-sight guidance along a spline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from undertow.errors import UndertowError

from .line_of_sight import Leg, LineOfSight
from .reference import Kinematics, MissionNumber


@dataclass(frozen=True)
class CurveSettings:
    """Numbers of curves."""

    # Steps to the foot of the perpendicular in a sample. The foot of the sample before is near, so that one
    # would do but for the first samples.
    steps: int = 2
    # Least share of its way that a curve makes in the plane: below it the course is undefined, or steeper
    # than a vehicle that drives along it can be.
    horizontal_share: float = 0.05
    samples_per_piece: int = 50  # points of a piece at which it is checked, and drawn
    rounds: int = 10  # of arc length as the parameter at the way-points


SETTINGS = CurveSettings()
_ORDER = 4  # coefficients of a cubic, lowest power first


class SplineOfSight(LineOfSight):
    """A natural cubic spline through way-points for a vehicle that steers along its heading.

    The place on the path is the foot of the perpendicular in the plane, followed from sample to sample by
    steps of Gauss and Newton. There, the law is that of a leg along the tangent; the rate of the course,
    which is curvature times speed over ground, is fed forward to the model of the heading, and so that of
    the incline.

    Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, chapter 12.
    """

    state_names: ClassVar[tuple[str, ...]] = ("path", *LineOfSight.state_names[1:])

    @cached_property
    def curve(self) -> CubicSpline:
        """The path, by nearly its arc length."""
        # A natural cubic spline, whose parameter at the way-points is the arc length up to them, nearly.
        lengths = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        for _ in range(SETTINGS.rounds):
            knots = np.concatenate([[0.0], np.cumsum(lengths)])
            curve = CubicSpline(knots, self.points, bc_type="natural")
            inner = knots[:-1, None] + np.diff(knots)[:, None] * np.linspace(0, 1, SETTINGS.samples_per_piece)
            lengths = np.linalg.norm(np.diff(curve(inner), axis=1), axis=2).sum(axis=1)
        return curve

    @property
    def knots(self) -> np.ndarray:
        """Parameters of the path at the way-points."""
        return np.asarray(self.curve.x)

    def _course_angles(self) -> np.ndarray:
        north, east, _ = self.curve(self.knots, 1).T
        return np.asarray(np.arctan2(east, north))

    def _check(self) -> None:
        """Refuse a path that stands upright, or bends more than the turn rate allows at the speed."""
        slope = self.curve(self.samples, 1)
        level = np.hypot(slope[:, 0], slope[:, 1]) / np.linalg.norm(slope, axis=1)
        if level.min() < SETTINGS.horizontal_share:
            raise UndertowError(
                f"the spline has no horizontal direction between {self.between(level.argmin())}: "
                "move them apart"
            )
        curvature, limit = self.curvatures, self.limits.turn_rate / self.limits.speed
        if curvature.max() > limit:
            raise UndertowError(
                f"the spline has a radius of {1 / curvature.max():.3g} m between "
                f"{self.between(curvature.argmax())}, but speed and turn_rate allow {1 / limit:.3g} m: move "
                "way-points apart, or go slower"
            )

    @cached_property
    def samples(self) -> np.ndarray:
        """Parameters of the path at which it is checked and drawn."""
        parts = [
            np.linspace(a, b, SETTINGS.samples_per_piece)
            for a, b in zip(self.knots[:-1], self.knots[1:], strict=True)
        ]
        return np.concatenate(parts)

    @property
    def path(self) -> np.ndarray:
        """The path in the plane, shape (k, 2)."""
        return np.asarray(self.curve(self.samples)[:, :2])

    @property
    def curvatures(self) -> np.ndarray:
        """Curvature in the plane at the samples, magnitude, 1/m."""
        slope, second = (self.curve(self.samples, order)[:, :2].T for order in (1, 2))
        turn = slope[0] * second[1] - slope[1] * second[0]
        return np.asarray(np.abs(turn) / np.hypot(*slope) ** 3)

    def between(self, sample: np.intp) -> str:
        """Words for the place of a sample."""
        piece = int(sample) // SETTINGS.samples_per_piece + 1
        return f"way-points {piece} and {piece + 1}"

    def tangents(self) -> np.ndarray:
        """Direction of the path at every way-point, shape (k, 3)."""
        found = np.asarray(self.curve(self.knots, 1))
        return found / np.linalg.norm(found, axis=1)[:, None]

    @property
    def _path_numbers(self) -> list[MissionNumber]:
        """Knots, m, then coefficients by piece, coordinate and power."""
        table = self.curve.c[::-1].transpose(1, 2, 0)  # (pieces, 3, 4)
        return [MissionNumber(f"path_{i}", "m", float(w)) for i, w in enumerate(self.knots)] + [
            MissionNumber(f"{c}_{i}_s{k}", f"m/m^{k}" if k else "m", float(value))
            for i, piece in enumerate(table)
            for c, row in zip("xyz", piece, strict=True)
            for k, value in enumerate(row)
        ]

    def _leg(self, r: ca.SX, s: ca.SX, kin: Kinematics) -> Leg:
        place = ca.vertcat(*[kin.eta[kin.index(c)] if c in kin.names else ca.SX(0) for c in "xyz"])
        # Position relative to the tangent at the foot; `along` and `length` are those of the path.
        w, end, (point, slope, second) = self._foot(r, s, place)
        north, east, down = ca.vertsplit(slope)
        flat = ca.sqrt(north**2 + east**2)
        course, incline = ca.atan2(east, north), -ca.atan2(down, flat)
        x, y, z = ca.vertsplit(place - point)
        cross = (north * y - east * x) / flat
        curvature = (north * second[1] - east * second[0]) / flat**3
        d_horizontal = (north * second[0] + east * second[1]) / flat
        incline_rate = (down * d_horizontal - second[2] * flat) / (flat**2 + down**2) / flat
        to_end = ca.norm_2(place - self._path_point(r, r[len(self.points) - 1])[0])
        return Leg(
            course, incline, w, end, cross, z * ca.cos(incline), to_end, point[2], curvature, incline_rate
        )

    def _progress(self, r: ca.SX, s: ca.SX, kin: Kinematics, leg: Leg) -> tuple[dict[str, ca.SX], ca.SX]:
        """The foot of the perpendicular, and whether it has come to the end; the integral stays."""
        reached = leg.length - leg.along <= self._values(r)["acceptance"]
        return {"path": leg.along, "arrived": ca.fmax(s[1], reached)}, ca.SX(1)

    def _foot(self, r: ca.SX, s: ca.SX, place: ca.SX) -> tuple[ca.SX, ca.SX, tuple[ca.SX, ca.SX, ca.SX]]:
        """Parameter at the foot, the last parameter, and the point there with two derivatives."""
        end = r[len(self.points) - 1]
        lookahead, w = self._values(r)["lookahead"], s[0]
        for _ in range(SETTINGS.steps):
            point, slope, _ = self._path_point(r, w)
            ahead = ca.dot((place - point)[:2], slope[:2]) / ca.sumsqr(slope[:2])
            w = ca.fmax(0, ca.fmin(end, w + ca.fmax(-lookahead, ca.fmin(lookahead, ahead))))
        return w, end, self._path_point(r, w)

    def _path_point(self, r: ca.SX, w: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The point of the path with its first and second derivative, shape (3, 1) each."""
        count = len(self.points)
        knots, pieces = r[:count], count - 1
        table = ca.reshape(r[count : count + 3 * _ORDER * pieces], 3 * _ORDER, pieces)
        # After the last knot that is passed; on the first piece before it, too.
        passed = [ca.SX(1), *(w >= knots[i] for i in range(1, pieces)), ca.SX(0)]
        here = ca.vertcat(*[now - then for now, then in pairwise(passed)])
        since = w - knots[:pieces].T @ here
        own = ca.reshape(table @ here, _ORDER, 3)
        a, b, c, d = (own[k, :].T for k in range(_ORDER))
        point = a + since * (b + since * (c + since * d))
        return point, b + since * (2 * c + 3 * since * d), 2 * c + 6 * since * d

    def _positions(self, named: dict[str, np.ndarray], places: list[np.ndarray]) -> Leg:
        """Position relative to the path over rows."""
        eta, w = ca.SX.sym("eta", 3), ca.SX.sym("w")
        kin = Kinematics(("x", "y", "z"), eta, ca.SX.zeros(3), ca.SX.eye(3), ca.SX.zeros(3, 3))
        leg = self._leg(ca.DM([n.value for n in self.numbers]), w, kin)
        found = ca.Function("passed", [eta, w], [ca.vertcat(*leg)])(np.array(places), named["path"][None])
        return Leg(*np.asarray(found))
