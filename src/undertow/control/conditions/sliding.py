"""Conditions on the gains of the sliding-mode laws, for a model that is known.

With the force of the law in the equations of motion, S_dot = -reach(S) exactly, one channel at a time; what
the true parameters change in that is looked at in the module `reaching`.
"""

from __future__ import annotations

from typing import Any

from .condition import Condition, Signs

_PAPER = "mini-AUV paper (2021), text of (34) and (35)"


class Reaches(Condition):
    id = "K_Z"
    form = "printed"
    statement = "K_Z > 0"
    matrices = "K_Z ≻ 0"
    about = "S' S_dot = -sum K_Z |S| is negative: the surface is reached in the time |S|/K_Z."
    source = _PAPER

    def left(self, s: Signs) -> Any:
        return s.K_Z


class Slides(Condition):
    id = "Lambda"
    form = "printed"
    statement = "Λ > 0"
    matrices = "Λ ≻ 0"
    about = "On the surface e_dot = -Λ e, so that the error dies out."
    source = _PAPER

    def left(self, s: Signs) -> Any:
        return s.Lambda


class DerivedSlides(Slides):
    form = "derived"
    source = "derived here: S = 0 means q_dot = Λ (q_d - q)"


class DerivedReaches(Reaches):
    form = "derived"
    source = "derived here from V = S' S/2 along the closed loop"


class HasWidth(Condition):
    id = "width"
    form = "derived"
    statement = "width > 0"
    matrices = "width ≻ 0"
    about = (
        "Inside the layer S_dot = -(K_Z/width) S: S dies out, so on the exact model nothing is left of it."
    )
    source = "derived here from V = S' S/2; Slotine and Li (1991), chapter 7"

    def left(self, s: Signs) -> Any:
        return s.width


class Root(Condition):
    id = "K_1"
    form = "derived"
    statement = "K_1 > 0"
    matrices = "K_1 ≻ 0"
    about = "V = K_2 |S| + twist²/2 has V_dot = -K_1 K_2 √|S|; bounds on disturbances are not certified."
    source = "derived here; finite time: Levant (1993)"

    def left(self, s: Signs) -> Any:
        return s.K_1


class Twist(Root):
    id = "K_2"
    statement = "K_2 > 0"
    matrices = "K_2 ≻ 0"
    about = "V = K_2 |S| + twist²/2 is positive everywhere but at S = twist = 0."

    def left(self, s: Signs) -> Any:
        return s.K_2
