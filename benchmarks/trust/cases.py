"""The plan: which cases are diagnosed, in which order, from one base seed."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from benchmarks.hidden_effects import EFFECTS
from benchmarks.hidden_effects.hardships import TIMES
from benchmarks.hidden_effects.registry import NOTHING_HIDDEN
from benchmarks.hidden_effects.vehicles import NOMINAL
from undertow.model.catalogue import catalogue

T = TypeVar("T")

#: A number that was not used while the program was developed.
BASE_SEED = 4711
#: Rounds of each plan; every round has every effect, of the catalogue or not, and every kind of complete
#: model once.
ROUNDS = {"quick": 1, "full": 12}
SIZES = (0.4, 1.0, 2.5)
#: Range of what the truth is worth in cases that are made to be hard (see `sizing`).
FAINT = (1.1, 3.0)
NOISES = (1.0, 1.0, 0.3, 3.0)
FEEDBACK = (False, False, False, True)
VARIANTS = ("plain", "60s", "pose-only", "mass-5", "filtered", "20min")
#: Complete models: label -> hidden (a wrong guess), noise, closed loop, variant.
COMPLETE: dict[str, tuple[tuple[str, ...], float, bool, str]] = {
    "as drawn": ((), 1.0, False, "plain"),
    "0.3 x noise": ((), 0.3, False, "plain"),
    "2 x noise": ((), 2.0, False, "plain"),
    "3 x noise": ((), 3.0, False, "plain"),
    "60-s logs": ((), 1.0, False, "60s"),
    "closed loop": ((), 1.0, True, "plain"),
    "mass known to 5%": ((), 1.0, False, "mass-5"),
    "one drag 2 x off": (("wrong_drag",), 1.0, False, "plain"),
    "one added mass 2 x off": (("wrong_added_mass",), 1.0, False, "plain"),
    "all guesses 2 x off": (("wrong_all",), 1.0, False, "plain"),
}
#: What makes a log as hard as a real one: label -> disturbances, variant.
HARD: dict[str, tuple[tuple[str, ...], str]] = {
    **{f"white forces, {n} x": ((f"white_force_{n}",), "plain") for n in TIMES},
    **{f"slow forces, {n} x": ((f"slow_force_{n}",), "plain") for n in TIMES},
    "filtered records": ((), "filtered"),
    "20-min logs": ((), "20min"),
    "pose only": ((), "pose-only"),
}
#: Effects that are those of the catalogue in another form: values of each run, another law, a whole term.
OTHER_FORMS = (
    "ocean_current_per_run", "waves_per_run", "thrust_loss_straight", "no_added_mass",
    "no_rigid_body_coriolis",
)  # fmt: skip
#: Effects of the catalogue. One that goes by the name of another is left out (a dead band with a jump): its
#: equations are not those of the catalogue, so that neither that name nor `unexplained` would be wrong.
SINGLES = tuple(name for name, effect in EFFECTS.items() if effect.catalogue == name)
#: Those that a log of the pose alone can show: it has no velocity sensor that could err.
_OF_NO_VELOCITY_SENSOR = tuple(n for n in SINGLES if not getattr(catalogue()[n], "of_velocity_sensor", False))
NULLS_PER_ROUND = 2
PAIRS_PER_ROUND = 8
_ALIKE = ({"net_buoyancy", "constant_force"},)


@dataclass(frozen=True)
class Planned:
    """One case to be diagnosed.

    vehicle: name of the vehicle.
    hidden: names from `EFFECTS`; none, or only a wrong guess, for a complete model.
    strength, noise: factors on the drawn sizes and on the noise.
    aim: what the truth is to be worth, the strength being chosen for it; zero where the strength is given.
    closed_loop: whether heading and depth are held by feedback.
    variant: one of `VARIANTS`.
    seed: seed of the simulator.
    """

    vehicle: str
    hidden: tuple[str, ...]
    strength: float
    noise: float
    closed_loop: bool
    variant: str
    seed: int
    aim: float = 0.0

    @property
    def id(self) -> str:
        """All that makes the case, as one word."""
        return f"{self._recipe}:{self.seed}"

    @property
    def _recipe(self) -> str:
        loop = "closed" if self.closed_loop else "open"
        hidden = "+".join(self.hidden) or "nothing"
        size = f"r{self.aim:g}" if self.aim else f"x{self.strength:g}"
        return f"{self.vehicle}:{hidden}:{size}:n{self.noise:g}:{loop}:{self.variant}"

    @property
    def kind(self) -> str:
        """`complete`, `single`, `pair`, `uncatalogued` or `hard` (of `HARD` or `OTHER_FORMS`)."""
        kinds = [EFFECTS[name].kind for name in self.hidden if EFFECTS[name].kind not in NOTHING_HIDDEN]
        if "alien" in kinds:
            return "uncatalogued"
        return "hard" if kinds and self._hardship else ("complete", "single", "pair")[len(kinds)]

    @property
    def _hardship(self) -> str:
        """Label of what makes it hard; empty where nothing does."""
        forces = tuple(name for name in self.hidden if EFFECTS[name].kind == "disturbance")
        found = (label for label, made in HARD.items() if made == (forces, self.variant))
        return next((name for name in self.hidden if name in OTHER_FORMS), next(found, ""))

    @property
    def label(self) -> str:
        """What is special about a complete model, or what makes a case hard."""
        own = (self.hidden, self.noise, self.closed_loop, self.variant)
        usual = next((label for label, made in COMPLETE.items() if made == own), "other")
        return self._hardship or usual

    @classmethod
    def read(cls, word: str) -> Planned:
        """The case of an id."""
        try:
            vehicle, hidden, size, noise, loop, variant, seed = word.split(":")
            names = () if hidden == "nothing" else tuple(hidden.split("+"))
            aim = float(size[1:]) if size[0] == "r" else 0.0
            strength = 1.0 if aim else float(size[1:])
            case = cls(vehicle, names, strength, float(noise[1:]), loop == "closed", variant, int(seed), aim)
            if case.id != word or case.variant not in VARIANTS or not set(names) <= set(EFFECTS):
                raise ValueError(word)
        except (ValueError, IndexError):
            raise ValueError(
                f"{word!r} is no case: ids look like usv:lift:x1:n1:open:plain:17 (see list)"
            ) from None
        return case


def plan(rounds: int, base: int = BASE_SEED) -> list[Planned]:
    """The cases in the order in which they are run: every beginning of it is a balanced sample."""
    return [case for r in range(rounds) for case in _round(r, base)]


def part(cases: Sequence[T], which: str) -> list[T]:
    """Every n-th case, `which` = "i/n" with i from 1."""
    first, _, count = which.partition("/")
    if not (first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise ValueError(f"--part {which!r}: give i/n with 1 <= i <= n, such as 2/4")
    return list(cases[int(first) - 1 :: int(count)])


def _round(r: int, base: int) -> list[Planned]:
    singles = [_one(name, r, base) for name in SINGLES]
    singles += [_faint(name, r, base) for name in SINGLES]
    uncatalogued = [_one(name, r, base) for name, e in EFFECTS.items() if e.kind == "alien"]
    complete = [_complete(label, NULLS_PER_ROUND * r + i, base)
                for label in COMPLETE for i in range(NULLS_PER_ROUND)]  # fmt: skip
    pairs = [_pair(PAIRS_PER_ROUND * r + i, base) for i in range(PAIRS_PER_ROUND)]
    usual = mixed([singles, uncatalogued, complete, pairs], seeded_generator(base, "order", r))
    # Between the usual ones, whose order stays what it was.
    return spread([usual, _hard(r, base)])


def _hard(r: int, base: int) -> list[Planned]:
    """Of each hardship one complete model and one with an effect, and of each other form one."""
    found = []
    for label, (forces, variant) in HARD.items():
        names = _OF_NO_VELOCITY_SENSOR if variant == "pose-only" else SINGLES
        name = _turn(names, r, base, f"{label} effect")
        recipes = (tuple(NOMINAL), forces), (EFFECTS[name].vehicles, (name, *forces))
        for vehicles, hidden in recipes:
            vehicle = _turn(vehicles, r, base, f"{label} {hidden} vehicle")
            found.append(_seeded((vehicle, hidden, 1.0, 1.0, False, variant), r, base))
    for name in OTHER_FORMS:
        vehicle = _turn(EFFECTS[name].vehicles, r, base, f"{name} vehicle")
        found.append(_seeded((vehicle, (name,), 1.0, 1.0, False, "plain"), r, base))
    return [found[int(k)] for k in seeded_generator(base, "hard order", r).permutation(len(found))]


def _one(name: str, r: int, base: int) -> Planned:
    vehicle = _turn(EFFECTS[name].vehicles, r, base, f"{name} vehicle")
    size = _turn(SIZES, r, base, f"{name} size")
    return _seeded((vehicle, (name,), size, *_conduct(name, r, base), "plain"), r, base)


def _faint(name: str, r: int, base: int) -> Planned:
    """A case in which the truth is worth little, for these decide how good a method is."""
    vehicle = _turn(EFFECTS[name].vehicles, r, base, f"{name} faint vehicle")
    low, high = np.log(FAINT)
    aim = float(f"{np.exp(seeded_generator(base, f'{name} faint', r).uniform(low, high)):.3g}")
    recipe = (vehicle, (name,), 1.0, *_conduct(f"{name} faint", r, base), "plain")
    return _seeded(recipe, r, base, aim)


def _conduct(what: str, r: int, base: int) -> tuple[float, bool]:
    return _turn(NOISES, r, base, f"{what} noise"), _turn(FEEDBACK, r, base, f"{what} feedback")


def spread(lists: Iterable[list[T]]) -> list[T]:
    """All entries, each list in its order and spread evenly over the whole."""
    placed = [((i + 0.5) / len(own), entry) for own in lists for i, entry in enumerate(own)]
    return [entry for _, entry in sorted(placed, key=lambda pair: pair[0])]


def _complete(label: str, number: int, base: int) -> Planned:
    hidden, noise, closed_loop, variant = COMPLETE[label]
    vehicle = _turn(tuple(NOMINAL), number, base, label)
    return _seeded((vehicle, hidden, 1.0, noise, closed_loop, variant), number, base)


def _pair(number: int, base: int) -> Planned:
    vehicle = _turn(tuple(NOMINAL), number, base, "pair vehicle")
    names = [n for n in SINGLES if vehicle in EFFECTS[n].vehicles]
    rng = seeded_generator(base, "pair", number)
    while True:
        first, second = (names[int(i)] for i in rng.permutation(len(names))[:2])
        if {first, second} not in _ALIKE:
            break
    noise, closed_loop = _conduct("pair", number, base)
    return _seeded((vehicle, (first, second), 1.0, noise, closed_loop, "plain"), number, base)


def _seeded(
    recipe: tuple[str, tuple[str, ...], float, float, bool, str], number: int, base: int, aim: float = 0.0
) -> Planned:
    """The case with a seed of its own, which does not depend on what else is in the plan."""
    draft = Planned(*recipe, seed=0, aim=aim)
    return replace(draft, seed=zlib.crc32(f"{base} {number} {draft.id}".encode()) % 10**8)


def _turn(options: Sequence[T], number: int, base: int, purpose: str) -> T:
    """One option after the other in random order, each once before any comes again."""
    lap, place = divmod(number, len(options))
    return options[int(seeded_generator(base, purpose, lap).permutation(len(options))[place])]


def seeded_generator(base: int, purpose: str, number: int) -> np.random.Generator:
    """Dice of their own for each purpose, so that none depends on what else is drawn."""
    return np.random.default_rng([base, zlib.crc32(purpose.encode()), number])


def mixed(kinds: Iterable[list[T]], rng: np.random.Generator) -> list[T]:
    """All cases, every kind shuffled and spread evenly over the whole."""
    placed = []
    for cases in kinds:
        order, shift = rng.permutation(len(cases)), rng.random()
        placed += [((i + shift) / len(cases), cases[int(k)]) for i, k in enumerate(order)]
    return [case for _, case in sorted(placed, key=lambda entry: entry[0])]
