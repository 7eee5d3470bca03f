"""Putting effects together: flow into relative velocity, commands through the chain, wrenches in a sum."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property, lru_cache
from typing import NamedTuple

import sympy as sm

from .catalogue import catalogue
from .effect import Actuation, Effect, Flow, Measurement, Wrench
from .kinematics import pose_jacobian, rotation, skew
from .symbols import FORCE, Signals, column, signals, spelled_out, symbol

_HALF = sm.Rational(1, 2)
# Statements of effects that are remembered: those of a whole catalogue on some vehicles.
_REMEMBERED = 512
Meanings = tuple[tuple[sm.Symbol, sm.Expr], ...]


class _Setting(NamedTuple):
    """What the equations of one effect depend on besides the effect.

    Vehicles that differ by one effect, as the candidates of a diagnosis do, mostly have it in common.
    """

    dofs: tuple[int, ...]
    meanings: Meanings

    def reduce(self, expression: sm.Matrix) -> sm.Matrix:
        """An expression of effects in terms of the vehicle's own motion, commands and parameters."""
        return expression.xreplace(dict(self.meanings))


@lru_cache(maxsize=_REMEMBERED)
def stated(effect: Wrench) -> sm.ImmutableMatrix:
    """Wrench of an effect as it states it, abbreviations spelled out, shape (6, 1)."""
    s = signals(effect.thrusters)
    return effect.spelled_out(effect.wrench(s), s).as_immutable()


@lru_cache(maxsize=_REMEMBERED)
def _reduced(effect: Wrench, setting: _Setting) -> sm.ImmutableMatrix:
    """Wrench of an effect in the degrees of freedom of a vehicle."""
    return setting.reduce(stated(effect).extract(list(setting.dofs), [0]))


class Composition:
    """The equations of a set of effects in the chosen degrees of freedom.

    Parameters
    ----------
    effects : tuple of Effect
        All effects, those of the hardware included.
    dofs : tuple of int
        Degrees of freedom, indices among the six.
    thrusters : tuple of str
        Names of the thrusters.
    forces : tuple of str
        Force symbols that the log holds (tau_X ...).
    split : mapping
        Parameters with different values forward and backward: name to the two symbols.
    """

    def __init__(
        self,
        effects: tuple[Effect, ...],
        dofs: tuple[int, ...],
        thrusters: tuple[str, ...],
        forces: tuple[str, ...] = (),
        split: Mapping[str, tuple[sm.Symbol, sm.Symbol]] | None = None,
    ) -> None:
        self.effects, self.dofs, self.thrusters, self.forces = effects, dofs, thrusters, forces
        self.split = dict(split or {})
        self.signals: Signals = signals(thrusters)

    # --- symbols of the chosen degrees of freedom --------------------------------------------
    @property
    def eta(self) -> sm.Matrix:
        """Pose, shape (n, 1)."""
        return self._rows(self.signals.eta)

    @property
    def nu(self) -> sm.Matrix:
        """Body velocity, shape (n, 1)."""
        return self._rows(self.signals.nu)

    @property
    def nu_dot(self) -> sm.Matrix:
        """Body acceleration, shape (n, 1)."""
        return self._rows(self.signals.nu_dot)

    @property
    def commands(self) -> sm.Matrix:
        """Commands of the thrusters, then known forces, shape (n_commands, 1)."""
        return column([f"command_{n}" for n in self.thrusters] + list(self.forces))

    def _rows(self, six: sm.Matrix) -> sm.Matrix:
        return six.extract(list(self.dofs), list(range(six.cols)))

    def of_kind(self, kind: type[Effect]) -> tuple[Effect, ...]:
        """Effects of one kind, actuation and measurement in the order of their chains."""
        found = [e for e in self.effects if isinstance(e, kind)]
        return tuple(sorted(found, key=lambda e: getattr(e, "stage", 0)))

    # --- what is frozen, and what depends on what ---------------------------------------------
    @cached_property
    def locked(self) -> dict[sm.Symbol, sm.Expr]:
        """Zero for motions that the vehicle does not have and forces that the log does not hold."""
        s = self.signals
        motions = [m[i] for m in (s.eta, s.nu, s.nu_dot) for i in range(6) if i not in self.dofs]
        absent = [symbol(f"tau_{n}") for n in FORCE if f"tau_{n}" not in self.forces]
        return dict.fromkeys([*motions, *absent, *self._absent_parameters()], sm.Integer(0))

    def _absent_parameters(self) -> list[sm.Symbol]:
        """Parameters that an effect would share if the vehicle had them."""
        present = {e.id for e in self.effects}
        absent = {i for e in self.effects for i in e.shares if i not in present}
        return [symbol(p.name) for i in absent for p in catalogue()[i](self.thrusters).parameters]

    @cached_property
    def water(self) -> tuple[sm.Matrix, sm.Matrix]:
        """Velocity of the water where the vehicle is, m/s, and its rate along the path, m/s^2; body axes."""
        s = self.signals
        back = rotation(sm.Matrix(s.eta[3:])).T
        flows = [e for e in self.effects if isinstance(e, Flow)]
        velocity = sum((f.spelled_out(f.velocity(s), s) for f in flows), sm.zeros(3, 1))
        rate = sum((f.spelled_out(f.acceleration(s), s) for f in flows), sm.zeros(3, 1))
        return back * velocity, back * rate

    @cached_property
    def relative_motion(self) -> dict[sm.Symbol, sm.Expr]:
        """Velocity through the water and its rate, in terms of motion over ground and the flow effects."""
        return self.relative_to(*self.water)

    def relative_to(self, water: sm.Matrix, rate: sm.Matrix) -> dict[sm.Symbol, sm.Expr]:
        """Velocity through water that moves like this (shapes (3, 1), body axes), and its rate.

        A motion that the vehicle does not have is none through the water either: a ship whose heave is left
        out would otherwise feel a beam current differently from its own sway when it rolls.
        """
        s = self.signals
        omega = sm.Matrix(s.nu[3:])
        velocity = sm.Matrix(s.nu[:3]) - water
        acceleration = sm.Matrix(s.nu_dot[:3]) + skew(omega) * water - rate
        relative = enumerate([*velocity, *acceleration])
        seen = [e if i % 3 in self.dofs else sm.Integer(0) for i, e in relative]
        return dict(zip([*s.nu_r[:3], *s.nu_r_dot[:3]], seen, strict=True))

    @cached_property
    def directional(self) -> dict[sm.Symbol, sm.Expr]:
        """Coefficients that differ forward and backward, as functions of the relative velocity."""
        motions = {p.name: p.motion for e in self.effects for p in e.parameters}
        return {symbol(n): self._by_sign(f, b, motions[n]) for n, (f, b) in self.split.items()}

    def _by_sign(self, forward: sm.Expr, backward: sm.Expr, motion: int | None) -> sm.Expr:
        sign = sm.sign(self.signals.nu_r[motion])
        return _HALF * (forward + backward) + _HALF * (forward - backward) * sign

    def reduce(self, expression: sm.Matrix) -> sm.Matrix:
        """An expression of effects in terms of the vehicle's own motion, commands and parameters."""
        return self._setting.reduce(expression)

    @cached_property
    def _setting(self) -> _Setting:
        meanings = spelled_out([self.locked, self.relative_motion, self.directional])
        return _Setting(self.dofs, tuple(meanings.items()))

    # --- the sums -----------------------------------------------------------------------------
    @cached_property
    def wrenches(self) -> dict[Wrench, sm.Matrix]:
        """Wrench of every effect in the vehicle's degrees of freedom."""
        effects = [e for e in self.effects if isinstance(e, Wrench)]
        return {e: _reduced(e, self._setting).as_mutable() for e in effects}

    @cached_property
    def residual(self) -> sm.Matrix:
        """Sum of the wrenches, shape (n, 1)."""
        return sum(self.wrenches.values(), sm.zeros(len(self.dofs), 1))

    @cached_property
    def wrench_states(self) -> dict[sm.Symbol, sm.Expr]:
        """States that wrenches own and that the vehicle's motion can reach, with their rates."""
        return self._reachable(e for e in self.effects if isinstance(e, Wrench))

    def _reachable(self, effects: Iterable[Wrench]) -> dict[sm.Symbol, sm.Expr]:
        used, s = self.residual.free_symbols, self.signals
        rates = ((e.state_symbols, self.reduce(e.spelled_out(e.rates(s), s))) for e in effects)
        return {x: rate for pair in rates for x, rate in zip(*pair, strict=True) if x in used}

    @cached_property
    def chain(self) -> tuple[sm.Matrix, dict[sm.Symbol, sm.Expr], dict[sm.Symbol, sm.Expr]]:
        """Output of the actuation chain, rates of its states, and the states' values at rest."""
        value = column([f"command_{n}" for n in self.thrusters])
        rates: dict[sm.Symbol, sm.Expr] = {}
        rest: dict[sm.Symbol, sm.Expr] = {}
        for effect in self.of_kind(Actuation):
            assert isinstance(effect, Actuation)
            states = effect.state_symbols
            rates.update(zip(states, effect.rates(value, self.signals), strict=True))
            rest.update(zip(states, effect.rest_state(value).xreplace(rest), strict=True))
            value = effect.output(value, self.signals)
        # A step may feel the flow past the thruster (thrust loss), so it is reduced like a wrench.
        return self.reduce(value), {x: self.reduce(r) for x, r in rates.items()}, rest

    @cached_property
    def dead_time(self) -> sm.Expr:
        """Sum of the pure delays between command and thrust, s; none where there is nothing to command."""
        if not self.thrusters:
            return sm.Integer(0)
        return sum((e.dead_time() for e in self.effects if isinstance(e, Actuation)), sm.Integer(0))

    @cached_property
    def pose_rate(self) -> sm.Matrix:
        """d(eta)/dt = J(eta) nu in the vehicle's degrees of freedom."""
        return self._rows(pose_jacobian(self.signals.eta) * self.signals.nu).xreplace(self.locked)

    @cached_property
    def reported(self) -> tuple[sm.Matrix, sm.Matrix]:
        """Pose and velocity that the sensors report."""
        eta, nu = self.signals.eta, self.signals.nu
        for effect in self.of_kind(Measurement):
            assert isinstance(effect, Measurement)
            eta, nu = effect.reported(eta, nu, self.signals)
        return self._rows(eta).xreplace(self.locked), self._rows(nu).xreplace(self.locked)

    @cached_property
    def report_age(self) -> sm.Matrix:
        """How old what the sensors report is, pose then velocity, shape (2n, 1), s."""
        effects = [e for e in self.effects if isinstance(e, Measurement)]
        total = sum((e.age() for e in effects), sm.zeros(12, 1))
        return sm.Matrix.vstack(self._rows(total[:6, :]), self._rows(total[6:, :]))

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Parameters that occur in the equations, in the order of the effects; environment last."""
        chain, rates, _ = self.chain
        parts = [self.residual, chain, *self.reported, sm.Matrix([self.dead_time]), self.report_age]
        parts += [sm.Matrix(list(rates.values()) or [0]), sm.Matrix(list(self.wrench_states.values()) or [0])]
        used = {str(x) for part in parts for x in part.free_symbols}
        return tuple(n for n in self._declared_names() if n in used)

    def _declared_names(self) -> list[str]:
        names: dict[str, None] = {}
        for effect in self.effects:
            for p in effect.parameters:
                halves = self.split.get(p.name)
                names.update(dict.fromkeys([str(h) for h in halves] if halves else [p.name]))
        return [*names, "rho", "g"]
