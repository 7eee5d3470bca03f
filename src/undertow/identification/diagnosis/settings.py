"""Every number that decides a verdict, with its meaning, its unit and what chose it.

`python -m benchmarks.trust ablate` answers a fixed sample of cases with each of them switched off in turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import NamedTuple, TypeVar

from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import MORE_THAN_CHANCE, SURE

T = TypeVar("T")
_NEVER, _ALWAYS = float("inf"), float("-inf")
_NO_LIMIT = 10**6
# What chose a number.
_LEVEL = "usual level of a test"
_TIME = "saves time; chosen on the development cases"
_DEVELOPMENT = "chosen on the development cases; no ablation yet"
# Limits of `false_alarm_rate`: the least that 1000 draws can show, and what would make a name worthless.
_LEAST_RATE, _MOST_RATE = 0.005, 0.2


class About(NamedTuple):
    """What is known of one number.

    Attributes
    ----------
    meaning, unit, source : str
        What it is, its unit ("1" for shares, ratios and counts), and what chose it.
    off : float or None
        Value with which the rule has no effect; None where there is none without it.
    one_case : str
        The case of a benchmark that the rule was added for, where it was a single one.
    """

    meaning: str
    unit: str
    source: str
    off: float | None
    one_case: str


def _number(
    value: T, meaning: str, source: str, *, unit: str = "1", off: float | None = None, one_case: str = ""
) -> T:
    found: T = field(default=value, metadata={"about": About(meaning, unit, source, off, one_case)})
    return found


@dataclass(frozen=True)
class Settings:
    """The numbers of a diagnosis; errors are in units of the noise of the sensors throughout."""

    # --- what is noise ------------------------------------------------------------------------
    noise_known_to: float = _number(
        0.1, "share to which the variance of the sensors' noise is known", "scatter of its estimates", off=0.0
    )
    chance_errors: float = _number(
        4.0, "standard errors by which a mean square may exceed noise by chance", "1 in 30 000", off=0.0
    )
    any_channel: float = _number(
        1.3, "mean square of a simulated channel that is still noise", _DEVELOPMENT, off=_NEVER
    )
    all_channels: float = _number(
        1.1, "mean square over all simulated channels that is still noise", _DEVELOPMENT, off=_NEVER
    )
    slow_error: float = _number(
        1.0,
        "length of the means by which slow errors of a simulation show",
        _DEVELOPMENT,
        unit="s",
        off=_NEVER,
    )
    above_noise: float = _number(
        1.3, "mean square from which an equation counts as not explained by noise", _DEVELOPMENT, off=1.0
    )
    transfer_chance: float = _number(
        1e-3,
        "chance below which parameters may not move to suit the validation data",
        "a sea bed that the validation run comes nearer to",
        off=1.0,
        one_case="boundary_proximity whose validation run comes nearer",
    )
    transfer_steps: int = _number(3, "Gauss-Newton steps in which they move", "converged")

    # --- evidence -----------------------------------------------------------------------------
    false_alarm_rate: float = _number(
        0.01, "chance of naming an effect where nothing is missing", "option --false-alarms"
    )
    smallest_fall: float = _number(
        0.05, "fall of the mean square that is hidden in the noise", _DEVELOPMENT, off=0.0
    )
    as_good_chance: float = _number(
        0.01, "p-value below which the better of two models is better (rank test)", _LEVEL, off=1.0
    )
    null_draws: int = _number(1000, "draws of the null distribution of the best candidate", "shows 0.1 %")
    resamples: int = _number(200, "resamples for how often a candidate is the best", "shows 0.5 %")
    seed: int = _number(20150518, "seed of both", "any")
    more_than_chance: float = _number(
        MORE_THAN_CHANCE,
        "fall of the sum of squares that is more than chance",
        "twice a log-likelihood ratio, 1 in 18 000; `estimation.fitted`",
        off=0.0,
    )

    # --- one candidate ------------------------------------------------------------------------
    t_in_search: float = _number(
        4.0, "|t| below which a parameter is left out in the search", "one false one in 15 000", off=0.0
    )
    t_in_last_fit: float = _number(
        SURE, "|t| below which one is left out in the last fit", "as in `estimation.fitted`", off=4.0
    )
    finer_noise_share: float = _number(
        0.5, "share of the sum of squares left from which a candidate gets its own noise model", _DEVELOPMENT,
        off=0.0,
    )  # fmt: skip
    noise_rounds: int = _number(
        3, "times that the noise model of a better fit is estimated anew", _TIME, off=1
    )
    rough_step: float = _number(
        1e-4, "predicted share of the sum of squares below which a fit ends in the search", _TIME, off=0.0
    )
    first_step: float = _number(1e-2, "the same before the leading candidates are known", _TIME, off=0.0)
    many_starts: int = _number(
        4, "starts of a candidate that are linearised in full and fitted", _TIME, off=_NO_LIMIT
    )
    closer_steps: int = _number(2, "Gauss-Newton steps before several starts are compared", _DEVELOPMENT)
    line_periods: float = _number(
        3.0, "periods in the longest run from which a frequency is no trend", _DEVELOPMENT
    )
    line_grid: int = _number(4, "frequencies tried in a resolution cell", "resolves a line")
    line_neighbours: int = _number(12, "cells on either side that a line is compared with", _DEVELOPMENT)
    line_half_width: float = _number(
        1.0, "cells by which the frequency of waves may differ (Doppler shift)", _DEVELOPMENT
    )

    # --- one round of the search --------------------------------------------------------------
    worth_a_fit: float = _number(
        20.0, "predicted fall of the sum of squares from which a candidate is fitted", _TIME, off=_ALWAYS
    )
    full_fits: int = _number(10, "candidates of a round that are fitted in any case", _TIME, off=_NO_LIMIT)
    most_fits: int = _number(20, "candidates of a round that are fitted at the most", _TIME, off=_NO_LIMIT)
    near_best: float = _number(
        0.1,
        "share of the best predicted fall from which a candidate is fitted, up to the most",
        "where much is missing, many promise something, and simulation sees what the residual does not",
        off=0.0,
    )
    finalists: int = _number(6, "those fitted anew under the best one's noise model", _TIME, off=_NO_LIMIT)
    leader_rounds: int = _number(
        2, "times that another leader sets the noise model", "a disturbance that fed on a poor fit", off=1
    )
    out_of_reach: float = _number(
        2.0, "times the best mean square from which a finalist is not fitted again", _TIME, off=_NEVER
    )
    other_values_fall: float = _number(
        20.0, "fall of the sum of squares from which a fixed value is fitted", _DEVELOPMENT, off=_NEVER
    )

    # --- the search ---------------------------------------------------------------------------
    max_effects: int = _number(3, "effects that are added one after the other", _TIME, off=1)
    pair_candidates: int = _number(8, "candidates of which pairs are formed", _TIME)
    pairs_beside: int = _number(2, "pairs tried beside an effect that shows alone", _DEVELOPMENT, off=0)
    lone_pairs: int = _number(
        6, "pairs tried where no effect shows alone", "two pairs of the trust benchmark", off=0
    )
    leading: int = _number(
        4, "significant effects of which one that leaves only noise goes first", _DEVELOPMENT, off=0
    )
    rivals: int = _number(
        5, "significant effects tried in the place of one that was found", _TIME, off=_NO_LIMIT
    )
    more_parameters: int = _number(
        3,
        "parameters more than the plainest equivalent from which an effect is dropped",
        "an effect with enough parameters can be bent into another",
        off=_NO_LIMIT,
        one_case="ship:trim_offset:r1.27:n3:open:plain:30413423",
    )
    plain_error: float = _number(
        1.1,
        "times the leader's error up to which a much plainer effect is fitted again",
        "a tether with eight parameters ahead of a trim",
        off=0.0,
        one_case="ship:trim_offset:r1.27:n3:open:plain:30413423",
    )
    second_look_share: float = _number(
        0.5, "share of the excess that a search without process noise has to explain", _DEVELOPMENT, off=0.0
    )
    second_look_limit: float = _number(
        1000.0, "mean square up to which there is such a search", "small steady forces of a float", off=0.0
    )

    # --- validation by simulation -------------------------------------------------------------
    short_windows: float = _number(
        5.0, "windows in which models are compared", "headings of a true model diverge in long ones", unit="s"
    )
    long_windows: float = _number(20.0, "windows in which small forces show", _DEVELOPMENT, unit="s")
    unknown_past: float = _number(
        1.0, "beginning of a log that is not judged: earlier commands are unknown", "a lag for a dead time",
        unit="s", off=0.0,
    )  # fmt: skip
    unknown_share: float = _number(0.05, "the same as the largest share of the shortest run", "short logs")
    near_noise: float = _number(
        2.0, "mean square in simulation below which a model is nearly noise", _DEVELOPMENT, off=0.0
    )
    within_reach: float = _number(
        10.0, "mean square from which no fit by output error can bring it to noise", _TIME, off=_NEVER
    )
    far_off: float = _number(100.0, "mean square from which none is made", _TIME, off=_NEVER)
    worse_chance: float = _number(
        0.01, "p-value below which a model simulates worse (rank test over windows)", _LEVEL, off=0.0
    )
    testable_windows: int = _number(7, "windows from which the rank test can reach that", "rank test")
    unanimous_windows: int = _number(
        5, "windows from which fewer may decide where all agree", "short logs", off=_NO_LIMIT
    )
    notably_worse: float = _number(
        1.025,
        "times the best error from which another is worse where more than noise is left",
        "a trim error and a compass offset in a roll decay",
        off=1.0,
        one_case="roll decay of examples/kvlcc2.md",
    )
    size_change: float = _number(
        0.5,
        "standard deviation of the size of an effect between parts of the logs, as a share of the size, from "
        "which it is not the same effect everywhere; the same for its fall beside another effect",
        "below it 97.5 % of the parts have the same sign",
        off=_NEVER,
    )

    # --- where more than noise is left --------------------------------------------------------
    worth: float = _number(
        0.1, "fall of the error of long predictions from which an effect is worth adding", "option --worth",
        off=0.0,
    )  # fmt: skip
    simulated: int = _number(6, "candidates of a round that are fitted by output error", _TIME, off=_NO_LIMIT)
    most_effects: int = _number(6, "effects that are added where each is worth it", _TIME, off=1)
    best_share: float = _number(
        0.9,
        "share of the resamples in which the named effect, or one of a set, is the best, and in which "
        "predictions get better with what is added",
        _LEVEL,
        off=0.0,
    )
    kept_gain: float = _number(
        0.5,
        "share of its gain that an effect keeps beside another, up to which that one is an alternative",
        "half: nearer to all that it gains, or to nothing",
        off=_NEVER,
    )
    same_force: float = _number(
        0.9,
        "share of the force of a named effect that terms of another can give, from which that one is tried "
        "in its place with these terms alone",
        "what is left is a tenth of what the effect explains",
        off=1.0,
    )
    own_share: float = _number(
        0.5,
        "share of what a flexible function of its own variables explains that an effect explains",
        "else such a function does twice as well",
        off=0.0,
    )
    turning: float = _number(
        0.5,
        "range of the heading, rad, from which a force of the surroundings differs from one of the vehicle",
        "its direction in the vehicle then changes by a quarter of its size",
        off=0.0,
    )
    sensor_share: float = _number(
        0.1,
        "share of what exceeds the noise from which an effect of the sensors is no disturbance",
        "a tenth, as of what an effect has to be worth",
        off=_NEVER,
    )
    known_times: float = _number(
        2.0,
        "standard errors by which a time constant of an effect has to differ from zero",
        _LEVEL,
        off=0.0,
    )
    part_error: float = _number(
        0.5, "standard error of the size of an effect up to which a part of the logs counts", "two to one"
    )
    size_parts: int = _number(
        4,
        "parts of a run, and levels of a signal, between which the size of an effect is compared",
        "quarters",
    )

    # --- verdict and warnings -----------------------------------------------------------------
    named_share: float = _number(
        0.8,
        "share of the excess over noise that named effects explain",
        "a wrong effect often takes half of a residual, seldom four fifths",
        off=0.0,
    )
    nearly_noise: float = _number(
        2.0, "mean square of every equation up to which several effects are named", _DEVELOPMENT, off=0.0
    )
    many_alike: int = _number(
        4, "equivalent effects beyond which none is identifiable", _DEVELOPMENT, off=_NO_LIMIT
    )
    moved: float = _number(
        3.0, "standard deviations from which a parameter is far from its stated value", _LEVEL, off=_NEVER
    )
    at_home: float = _number(
        2.0, "standard deviations within which it is where it was stated", _LEVEL, off=_NEVER
    )
    comes_back: float = _number(
        0.5, "share of its way back from which an effect explains a moved parameter", _DEVELOPMENT
    )
    as_good_error: float = _number(
        1.05, "times the least error up to which an effect is named in a warning", _DEVELOPMENT, off=1.0
    )
    many_times: float = _number(
        3.0, "factor from which a value without standard deviation is far off", _DEVELOPMENT, off=_NEVER
    )
    same_commands: float = _number(
        0.15,
        "rms difference over their standard deviation up to which commands are repeated",
        "half a sample of clock error",
        off=0.0,
    )
    changed_command: float = _number(
        0.05, "standard deviation of a command, as a share of its largest, from which it changes", "the eye"
    )
    same_length: float = _number(0.5, "share of the shorter run over which they are compared", _DEVELOPMENT)
    manoeuvres: int = _number(20, "manoeuvres tried to separate equivalent effects", _TIME)

    # --- data ---------------------------------------------------------------------------------
    pieces: int = _number(6, "pieces of a run where no validation run is given", _DEVELOPMENT)
    validation_pieces: tuple[int, ...] = _number((1, 4), "those kept for validation, from 0", _DEVELOPMENT)
    piece_gap: float = _number(1.0, "gap between two pieces", "memory of the vehicle", unit="s")
    fewest_samples: int = _number(10, "samples of a run that can be cut", "no piece is empty")
    whole_below: float = _number(
        0.1, "share of the longest run below which one is fitted whole", "pieces of a push in a tank", off=0.0
    )
    excited: float = _number(
        2.0, "times its noise from which a velocity has moved", "noise alone has once its own", off=0.0
    )

    def __post_init__(self) -> None:
        if not _LEAST_RATE <= self.false_alarm_rate <= _MOST_RATE:
            raise UndertowError(
                f"a chance of false alarms of {self.false_alarm_rate:g} is not possible: choose one between "
                f"{_LEAST_RATE:g} and {_MOST_RATE:g} (0.01 by default)"
            )
        if not 0.0 <= self.worth < 1.0:
            raise UndertowError(
                f"an effect cannot have to lower the error by {self.worth:g} of it: choose --worth from 0 to "
                "below 1 (0.1, a tenth, by default)"
            )

    @classmethod
    def about(cls) -> dict[str, About]:
        """What is known of every number, by its name."""
        return {f.name: f.metadata["about"] for f in fields(cls)}


DEFAULT = Settings()
