"""The diagnosis on logs whose hidden effect is known: truth named, nothing named where nothing is missing or
nothing fits.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.diagnose import diagnose
from undertow.identification.diagnosis.bench import Score, open_bench
from undertow.identification.diagnosis.candidates import Candidate, candidates
from undertow.identification.diagnosis.evidence import compare_scores, explained
from undertow.identification.diagnosis.splitting import split_into_pieces
from undertow.identification.diagnosis.trial import try_candidate
from undertow.identification.estimation.data import prepare
from undertow.identification.logs.run import Run
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

_FEW = {i: catalogue()[i] for i in ("lift", "constant_force", "thruster_lag")}
_OF_A_BOX = {i: catalogue()[i] for i in ("quadratic_damping", "constant_force", "thruster_lag")}
_DRAGS = {i: c for i, c in catalogue().items() if "damping" in i or "drag" in i} | _FEW


def _case(vehicle: str, effects: tuple[str, ...], seed: int, **options: Any) -> tuple[Vehicle, list[Run]]:
    """The model that a user would start from, and four runs of the vehicle."""
    case = make_case(vehicle, effects, seed, **options)
    return vehicle_of(case), runs_of(case)


@pytest.mark.parametrize(
    ("vehicle", "effect", "seed", "known"),
    [
        ("box", "quadratic_damping", 7, _OF_A_BOX),
        pytest.param("usv", "lift", 11, _FEW, marks=pytest.mark.slow),
        pytest.param("usv", "lift", 11, _DRAGS, marks=pytest.mark.slow),
        pytest.param("mini-auv", "thruster_deadband", 12, None, marks=pytest.mark.slow),
        pytest.param("usv", "ocean_current", 13, None, marks=pytest.mark.slow),
    ],
)
def test_the_hidden_effect_is_named_and_the_error_falls_to_the_noise(
    vehicle: str, effect: str, seed: int, known: Catalogue | None
) -> None:
    model, runs = _case(vehicle, (effect,), seed, duration=40.0)
    outcome = diagnose(model, runs[:3], runs[3:], known=known)
    d = outcome.diagnosis
    named = {e for s in d.indistinguishable for e in s.effects} | set(d.effects)
    assert d.verdict in ("missing_effect", "indistinguishable")
    assert effect in named
    assert d.ranking[0].effect == effect
    assert d.steps[-1].error < 1.3
    assert d.steps[0].error > 1.5 * d.steps[-1].error
    assert d.steps[-1].prediction < d.steps[0].prediction
    assert any(e.id == effect for e in outcome.after.effects)


@pytest.mark.parametrize(
    ("vehicle", "effects", "known"),
    first_quick(
        [
            ("box", ("wrong_drag",), _FEW),
            ("usv", ("wrong_drag",), _FEW),
            ("usv", ("wrong_drag",), None),
            ("usv", (), None),
            ("mini-auv", (), None),
        ]
    ),
)
def test_nothing_is_named_where_nothing_is_missing(
    vehicle: str, effects: tuple[str, ...], known: Catalogue | None
) -> None:
    model, runs = _case(vehicle, effects, 21, duration=40.0)
    d = diagnose(model, runs[:3], runs[3:], known=known).diagnosis
    assert d.verdict == "adequate"
    assert d.effects == []
    assert not any(r.significant for r in d.ranking)


@pytest.mark.slow
def test_two_hidden_effects_are_both_named() -> None:
    model, runs = _case("usv", ("ocean_current", "thruster_lag"), 3, duration=30.0)
    known = {i: catalogue()[i] for i in ("ocean_current", "thruster_lag", "constant_force")}
    d = diagnose(model, runs[:2], runs[3:], known=known).diagnosis
    assert set(d.effects) == {"ocean_current", "thruster_lag"}
    assert d.steps[-1].error < 1.2


@pytest.mark.parametrize(
    ("vehicle", "duration", "known"),
    first_quick([("float", 40.0, _FEW), ("usv", 30.0, _FEW), ("usv", 30.0, _DRAGS)]),
    ids=["few", "few for a boat", "drags"],
)
def test_an_effect_that_no_catalogue_has_is_not_given_a_name(
    vehicle: str, duration: float, known: Catalogue
) -> None:
    model, runs = _case(vehicle, ("growing_drag",), 31, duration=duration)
    d = diagnose(model, runs[:3], runs[3:], known=known).diagnosis
    assert d.verdict in ("unexplained", "helps_prediction")  # both name no cause
    assert d.effects == []
    assert d.steps[0].error > 1.5
    assert any(r.normalised_error > 1.5 for r in d.remaining)


@pytest.mark.slow
def test_an_effect_that_leaves_most_of_a_faint_excess_is_no_cause() -> None:
    """Drag grows, hardly above the noise: fading thrust explains a seventh, and the rest passes for noise."""
    made = make_case("usv", ("growing_drag",), 17622791, strength=0.4, noise=3.0, duration=100.0)
    runs = runs_of(made)
    d = diagnose(vehicle_of(made), runs[:3], runs[3:]).diagnosis
    assert d.effects == []


@pytest.mark.slow
def test_the_same_logs_give_the_same_answer() -> None:
    model, runs = _case("usv", ("lift",), 11, duration=30.0)
    first, second = (diagnose(model, runs[:2], runs[3:], known=_FEW).diagnosis for _ in range(2))
    drop = {"seconds"}
    assert first.model_dump(exclude=drop) == second.model_dump(exclude=drop)


@pytest.mark.slow
def test_blocks_are_kept_aside_where_no_run_is_given() -> None:
    model, runs = _case("usv", ("lift",), 11, duration=60.0)
    outcome = diagnose(model, runs[:3], known=_FEW)
    assert outcome.diagnosis.effects == ["lift"]
    assert {r.role for r in outcome.diagnosis.runs} == {"blocks"}
    for train in outcome.train:
        for test in outcome.test:
            same = train.source == test.source
            assert not same or train.t[-1] < test.t[0] or test.t[-1] < train.t[0]


def test_blocks_cover_a_third_and_leave_gaps() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    train, test = split_into_pieces([Run("a", t, {"u": np.sin(t)})])
    assert len(train) == 4
    assert len(test) == 2
    assert sum(len(r.t) for r in test) / len(t) == pytest.approx(1 / 3, abs=0.05)
    edges = sorted((r.t[0], r.t[-1]) for r in [*train, *test])
    assert all(later[0] - earlier[1] > 0.5 for earlier, later in pairwise(edges))


def test_pieces_are_cut_from_what_was_recorded_and_not_from_a_pause() -> None:
    """A logger that lost the vehicle for longer than the log lasts: no piece lies in the pause."""
    for scale in (1.0, 0.03):
        t = scale * np.concatenate([np.arange(0.0, 80.0, 0.5), np.arange(9240.0, 9260.0, 0.5)])
        train, test = split_into_pieces([Run("a", t, {"u": np.sin(t)})])
        lengths = [len(r.t) for r in [*train, *test]]
        assert len(lengths) == 6
        assert min(lengths) > 0.3 * max(lengths)
        assert sum(r.t[-1] > 9240.0 * scale > r.t[0] for r in [*train, *test]) <= 1


def test_a_run_too_short_to_be_cut_is_refused() -> None:
    t = np.arange(0.0, 0.55, 0.1)
    with pytest.raises(UndertowError, match=r"run 'a' has 6 samples, too few .* --validation"):
        split_into_pieces([Run("a", t, {"u": np.sin(t)})])


def test_logs_in_which_nothing_moves_are_refused() -> None:
    model, runs = _case("usv", (), 1, duration=5.0)
    rng = np.random.default_rng(0)
    still = [Run(r.name, r.t, {n: 0.01 * rng.standard_normal(len(r.t)) for n in r.channels}) for r in runs]
    with pytest.raises(UndertowError, match="nothing moves"):
        diagnose(model, still[:3], still[3:])


def test_missing_parameters_of_a_present_effect_are_a_candidate() -> None:
    auv = load_vehicle("mini-auv")
    fewer = {n: v for n, v in auv.values.items() if n not in ("Z_wabsw", "N_rabsr")}
    found = {c.id: c for c in candidates(replace(auv, values=fewer), catalogue())}
    assert {"Z_wabsw", "N_rabsr"} <= {p.name for p in found["quadratic_damping"].parameters}
    assert "X_uabsu" not in {p.name for p in found["quadratic_damping"].parameters}


def test_hardware_and_present_effects_are_no_candidates() -> None:
    rov = load_vehicle("bluerov2")
    ids = {c.id for c in candidates(rov, catalogue())}
    assert not ids & {"thrusters", "generalised_force", "rigid_body", "linear_damping", "quadratic_damping"}
    assert {"ocean_current", "thruster_lag", "trim_offset", "velocity_lever_arm"} <= ids


def test_an_effect_that_the_degrees_of_freedom_cannot_show_is_no_candidate() -> None:
    box = load_vehicle("box-hull")
    ids = {c.id for c in candidates(box, catalogue())}
    assert not ids & {
        "lift",
        "linear_damping_coupling",
        "velocity_lever_arm",
        "added_mass_coriolis",
        "net_buoyancy",
    }


def test_a_time_constant_is_kept_with_its_gains() -> None:
    cls = catalogue()["radiation_memory"]
    candidate = Candidate(cls, load_vehicle("box-hull"))
    assert candidate.removable == ("X_memu",)


def test_how_narrow_a_friction_is_has_to_be_found_unless_the_model_has_it() -> None:
    candidate = Candidate(catalogue()["dry_friction"], load_vehicle("box-hull"))
    assert {p.name for p in candidate.parameters} == {"X_signu", "friction_speed"}
    there = candidate.vehicle_with({"X_signu": -1.0})
    assert Candidate(catalogue()["dry_friction"], there).parameters == ()
    assert there.value_of("friction_speed").value == 0.02


@pytest.mark.slow
def test_the_width_of_a_friction_that_is_not_there_goes_with_it() -> None:
    model, runs = _case("usv", ("dry_friction",), 16977316, strength=0.4, noise=0.3)
    bench = open_bench(model, *prepared(model, runs[:3], runs[3:]))
    found = try_candidate(Candidate(catalogue()["dry_friction"], model), bench, {"friction_rate": 0.01})
    assert "friction_speed" in found.fit.model.free
    assert ("friction_rate" in found.fit.model.free) is ("N_signr" in found.kept)
    assert "N_signr" not in found.kept


def _score(r: np.ndarray, mean_square: float) -> Score:
    return Score(r, np.array([mean_square, np.nan]))


def test_evidence_needs_a_consistent_fall() -> None:
    model, runs = _case("usv", (), 1, duration=60.0)
    data = prepare(runs[:1], model)
    rng = np.random.default_rng(3)
    r = rng.standard_normal(len(data.equation))
    lucky = r.copy()
    lucky[: len(r) // 40] = 0.0
    assert compare_scores(_score(1.2 * r, 1.44), _score(r, 1.0), data).p_value < 1e-5
    assert compare_scores(_score(r, 1.0), _score(lucky, 0.9), data).p_value > 0.001
    assert compare_scores(_score(r, 1.0), _score(r, 1.0), data).p_value == 1.0


def test_explained_share_is_measured_above_the_noise() -> None:
    noise = np.array([1.0, np.nan])
    assert explained(np.array([5.0, np.nan]), np.array([1.0, np.nan]), noise) == pytest.approx(1.0)
    assert explained(np.array([5.0, np.nan]), np.array([3.0, np.nan]), noise) == pytest.approx(0.5)
    assert explained(np.array([0.9, np.nan]), np.array([0.8, np.nan]), noise) == 0.0
