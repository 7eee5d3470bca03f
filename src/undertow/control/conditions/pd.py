"""Conditions on the gains of PD control with gravity compensation."""

from __future__ import annotations

from typing import Any

from .condition import Condition, Signs

_OWN = "derived here from V = q_dot' M q_dot/2 + e' K_P e/2 along the closed loop"


class PositiveSpring(Condition):
    id = "K_P"
    form = "printed"
    statement = "K_P > 0"
    matrices = "K_P ≻ 0"
    about = "The Lyapunov function (24) is positive, so that the set-point is its lowest place."
    source = "mini-AUV paper (2021), text of (20)"

    def left(self, s: Signs) -> Any:
        return s.K_P


class PositiveDamper(Condition):
    id = "K_V"
    form = "printed"
    statement = "K_V > 0"
    matrices = "K_V ≻ 0"
    about = "The law itself takes energy from every motion, as the paper demands it for (25)."
    source = "mini-AUV paper (2021), text of (20) and (25)"

    def left(self, s: Signs) -> Any:
        return s.K_V


class DampedMotion(Condition):
    id = "K_V + D"
    form = "derived"
    statement = "K_V + D > 0"
    matrices = "K_V + D_q ≻ 0"
    about = "Law and water together take energy from every motion; V_dot = -q_dot' (K_V + D_q) q_dot."
    source = _OWN
    uses = ("D",)

    def left(self, s: Signs) -> Any:
        return s.K_V + s.D


class Spring(PositiveSpring):
    form = "derived"
    source = _OWN
