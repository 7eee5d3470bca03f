"""Every threshold that decides a verdict, with its meaning, its unit and the reason for its value.

`python -m benchmarks.trust ablate` runs a fixed sample of cases with each of them switched off in turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import NamedTuple, TypeVar

from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import MORE_THAN_CHANCE, SIGNIFICANT_T

T = TypeVar("T")
_NEVER, _ALWAYS = float("inf"), float("-inf")
_NO_LIMIT = 10**6
# What chose a number.
_LEVEL = "usual level of a test"
_TIME = "saves time; chosen on the development cases"
_DEVELOPMENT = "chosen on the development cases; no ablation yet"


@dataclass(frozen=True)
class RateLimits:
    """Limits of `false_alarm_rate`."""

    least: float = 0.005  # that 1000 draws can show
    most: float = 0.2  # a larger one would make a name worthless


_RATES = RateLimits()


class Threshold(NamedTuple):
    """Description of one threshold.

    Attributes
    ----------
    meaning, unit, source : str
        What it is, its unit ("1" for fractions, ratios and counts), and the reason for its value.
    off : float or None
        Value with which the rule has no effect; None if there is none.
    one_case : str
        The benchmark case for which the rule was added, if it was a single one.
    """

    meaning: str
    unit: str
    source: str
    off: float | None
    one_case: str


def _field(
    value: T, meaning: str, source: str, *, unit: str = "1", off: float | None = None, one_case: str = ""
) -> T:
    found: T = field(default=value, metadata={"about": Threshold(meaning, unit, source, off, one_case)})
    return found


@dataclass(frozen=True)
class Settings:
    """Settings of a diagnosis; errors are in units of sensor noise throughout."""

    # --- what is noise ------------------------------------------------------------------------
    noise_uncertainty: float = _field(
        0.1, "relative uncertainty of the variance of sensor noise", "scatter of its estimates", off=0.0
    )
    chance_errors: float = _field(
        4.0, "standard errors by which a mean square may exceed noise by chance", "1 in 30 000", off=0.0
    )
    channel_noise_limit: float = _field(
        1.3, "largest mean square of a simulated channel that counts as noise", _DEVELOPMENT, off=_NEVER
    )
    mean_noise_limit: float = _field(
        1.1, "largest mean square over all simulated channels that counts as noise", _DEVELOPMENT, off=_NEVER
    )
    slow_error_window: float = _field(
        1.0,
        "averaging time with which slow errors of a simulation are detected",
        _DEVELOPMENT,
        unit="s",
        off=_NEVER,
    )
    equation_noise_limit: float = _field(
        1.3, "mean square above which noise does not explain an equation", _DEVELOPMENT, off=1.0
    )
    transfer_chance: float = _field(
        1e-3,
        "p-value below which parameters adjusted to the validation data are rejected",
        "a sea bed that the validation run approaches more closely",
        off=1.0,
        one_case="boundary_proximity whose validation run comes nearer",
    )
    transfer_steps: int = _field(3, "Gauss-Newton steps of that comparison", "converged")

    # --- evidence -----------------------------------------------------------------------------
    false_alarm_rate: float = _field(
        0.01, "probability of naming an effect when nothing is missing", "option --false-alarms"
    )
    least_fall: float = _field(
        0.05, "fall of the mean square below which an effect is ignored", _DEVELOPMENT, off=0.0
    )
    comparison_level: float = _field(
        0.01, "p-value below which one model is better than another (rank test)", _LEVEL, off=1.0
    )
    slow_blocks: float = _field(
        12, "least number of blocks of the training data for the test against a slow disturbance",
        "their signs resolve 1 in 2 000", off=_NEVER,
    )  # fmt: skip
    null_draws: int = _field(1000, "draws of the null distribution of the best candidate", "shows 0.1%")
    resamples: int = _field(200, "resamples to determine how often a candidate is the best", "shows 0.5%")
    seed: int = _field(20150518, "seed of draws and resamples", "any")
    more_than_chance: float = _field(
        MORE_THAN_CHANCE,
        "fall of the sum of squares that chance does not explain",
        "twice a log-likelihood ratio, 1 in 18 000; `estimation.fitted`",
        off=0.0,
    )

    # --- one candidate ------------------------------------------------------------------------
    t_in_search: float = _field(
        4.0, "|t| below which the search drops a parameter", "one false positive in 15 000", off=0.0
    )
    t_in_last_fit: float = _field(
        SIGNIFICANT_T, "|t| below which the last fit drops a parameter", "as in `estimation.fitted`", off=4.0
    )
    finer_noise_share: float = _field(
        0.5, "remaining fraction of the sum of squares below which a candidate gets its own noise model",
        _DEVELOPMENT, off=0.0,
    )  # fmt: skip
    noise_rounds: int = _field(3, "number of reestimates of the noise model of a better fit", _TIME, off=1)
    rough_step: float = _field(
        1e-4,
        "predicted relative fall of the sum of squares below which a fit ends, in the search",
        _TIME,
        off=0.0,
    )
    first_step: float = _field(1e-2, "the same limit before the leading candidates are known", _TIME, off=0.0)
    fitted_starts: int = _field(
        4,
        "number of starting values of a candidate that are fully linearised and fitted",
        _TIME,
        off=_NO_LIMIT,
    )
    steps_per_start: int = _field(2, "Gauss-Newton steps before starting values are compared", _DEVELOPMENT)
    line_periods: float = _field(
        3.0, "periods in the longest run above which a frequency is not a trend", _DEVELOPMENT
    )
    line_grid: int = _field(4, "frequencies tried per resolution cell", "resolves a line")
    line_neighbours: int = _field(12, "cells on either side that a line is compared with", _DEVELOPMENT)
    line_half_width: float = _field(
        1.0, "cells by which the frequency of waves may be shifted (Doppler)", _DEVELOPMENT
    )

    # --- one round of the search --------------------------------------------------------------
    least_predicted_fall: float = _field(
        20.0, "least predicted fall of the sum of squares for which a candidate is fitted", _TIME, off=_ALWAYS
    )
    full_fits: int = _field(10, "candidates of a round that are always fitted", _TIME, off=_NO_LIMIT)
    most_fits: int = _field(
        20, "largest number of candidates of a round that are fitted", _TIME, off=_NO_LIMIT
    )
    predicted_fall_share: float = _field(
        0.1,
        "predicted fall, relative to the best, above which a candidate is fitted, up to `most_fits`",
        "if much is missing, many candidates look promising, and simulation reveals more than the residual",
        off=0.0,
    )
    finalists: int = _field(
        6, "candidates refitted under the noise model of the best one", _TIME, off=_NO_LIMIT
    )
    leader_rounds: int = _field(
        2,
        "number of times that a new leading candidate sets the noise model",
        "a disturbance estimated from a poor fit",
        off=1,
    )
    refit_limit: float = _field(
        2.0, "mean square, relative to the best, above which a finalist is not refitted", _TIME, off=_NEVER
    )
    fixed_value_fall: float = _field(
        20.0, "least fall of the sum of squares for which a fixed value is fitted", _DEVELOPMENT, off=_NEVER
    )

    # --- the search ---------------------------------------------------------------------------
    max_effects: int = _field(3, "largest number of effects added one after the other", _TIME, off=1)
    pair_candidates: int = _field(8, "number of candidates from which pairs are formed", _TIME)
    pairs_beside: int = _field(
        2, "pairs tried in addition to a significant single effect", _DEVELOPMENT, off=0
    )
    pairs_alone: int = _field(
        6, "pairs tried if no single effect is significant", "two pairs of the trust benchmark", off=0
    )
    leading_effects: int = _field(
        4,
        "number of significant effects among which one that leaves only noise is preferred",
        _DEVELOPMENT,
        off=0,
    )
    rivals: int = _field(
        5, "number of significant effects tried in place of one that was found", _TIME, off=_NO_LIMIT
    )
    more_parameters: int = _field(
        3,
        "excess of parameters over the simplest equivalent at which an effect is dropped",
        "an effect with enough parameters can imitate another",
        off=_NO_LIMIT,
        one_case="ship:trim_offset:r1.27:n3:open:plain:30413423",
    )
    plain_error: float = _field(
        1.1,
        "error, relative to the leader, up to which a much simpler effect is refitted",
        "a tether with eight parameters ahead of a trim",
        off=0.0,
        one_case="ship:trim_offset:r1.27:n3:open:plain:30413423",
    )
    excess_share: float = _field(
        0.5,
        "fraction of the excess over noise that effects have to explain where only noise remains",
        "a model just above the limit of noise falls below it by chance",
        off=0.0,
    )
    second_look_limit: float = _field(
        1000.0,
        "mean square up to which a search without process noise is made",
        "small steady forces of a float",
        off=0.0,
    )

    # --- validation by simulation -------------------------------------------------------------
    short_windows: float = _field(
        5.0,
        "length of the windows in which models are compared",
        "in long ones, even the headings of the true model diverge",
        unit="s",
    )
    long_windows: float = _field(
        20.0, "length of the windows in which small forces are detected", _DEVELOPMENT, unit="s"
    )
    unknown_past: float = _field(
        1.0, "beginning of a log that is not scored, because earlier commands are unknown",
        "a lag for a dead time", unit="s", off=0.0,
    )  # fmt: skip
    unknown_share: float = _field(0.05, "largest share of the shortest run that this may take", "short logs")
    near_noise: float = _field(
        2.0,
        "mean square in simulation below which the residual of a model is nearly noise",
        _DEVELOPMENT,
        off=0.0,
    )
    output_error_reach: float = _field(
        10.0, "mean square above which output error cannot reach the noise", _TIME, off=_NEVER
    )
    output_error_limit: float = _field(
        100.0, "mean square above which no output-error fit is made", _TIME, off=_NEVER
    )
    worse_chance: float = _field(
        0.01, "p-value below which a model simulates worse (rank test over windows)", _LEVEL, off=0.0
    )
    testable_windows: int = _field(
        7, "least number of windows with which the rank test can reach that p-value", "rank test"
    )
    unanimous_windows: int = _field(
        5, "least number of windows that can decide if all agree", "short logs", off=_NO_LIMIT
    )
    notably_worse: float = _field(
        1.025,
        "error, relative to the best, above which a model is worse if the residual exceeds the noise",
        "a trim error and a compass offset in a roll decay",
        off=1.0,
        one_case="roll decay of examples/kvlcc2.md",
    )
    size_spread: float = _field(
        0.5,
        "standard deviation of the size of an effect between parts of the logs, relative to the size, above "
        "which it is not constant (a part in which zero is possible and 1 minus this is not has none of it); "
        "also the largest reduction of its size by a force built from the residual",
        "below it 97.5% of the parts have the same sign",
        off=_NEVER,
    )

    # --- if the residual exceeds the noise --------------------------------------------------------
    worth: float = _field(
        0.1, "relative fall of the error of long predictions for which an effect is added",
        "option --worth", off=0.0,
    )  # fmt: skip
    simulated_candidates: int = _field(
        6, "candidates of a round that are fitted by output error", _TIME, off=_NO_LIMIT
    )
    most_effects: int = _field(
        6, "largest number of effects added if the residual exceeds the noise", _TIME, off=1
    )
    best_share: float = _field(
        0.9,
        "fraction of the resamples in which the named effect, or one of a set, is the best, and in which "
        "it improves predictions",
        _LEVEL,
        off=0.0,
    )
    kept_gain: float = _field(
        0.5,
        "fraction of its gain that an effect may keep with its alternative in the model",
        "half: closer to its whole gain, or to nothing",
        off=_NEVER,
    )
    same_force: float = _field(
        0.9,
        "fraction of the force of a named effect that terms of another must reproduce to be tried in its "
        "place",
        "the rest is a tenth of what the effect explains",
        off=1.0,
    )
    own_share: float = _field(
        0.5,
        "fraction that an effect has to explain of what a flexible function of its variables explains",
        "otherwise such a function does twice as well",
        off=0.0,
    )
    least_turn: float = _field(
        0.5,
        "range of the heading, rad, above which a force fixed to the earth differs from one fixed to "
        "the vehicle",
        "its direction in the body frame then changes by a quarter of its size",
        off=0.0,
    )
    sensor_share: float = _field(
        0.1,
        "fraction of the excess over noise above which a measurement effect is not a disturbance",
        "a tenth, like the improvement required of an effect",
        off=_NEVER,
    )
    time_constant_t: float = _field(
        2.0,
        "standard errors by which the time constant of an effect has to differ from zero",
        _LEVEL,
        off=0.0,
    )
    part_error: float = _field(
        0.5,
        "largest standard error of the size of an effect for which a part of the logs counts",
        "two to one",
    )
    size_parts: int = _field(
        4,
        "parts of a run, and levels of a signal, between which the size of an effect is compared",
        "quarters",
    )

    # --- verdict and warnings -----------------------------------------------------------------
    named_share: float = _field(
        0.8,
        "fraction of the excess over noise that named effects have to explain",
        "a wrong effect often explains half of a residual, seldom four fifths",
        off=0.0,
    )
    resolved_time: float = _field(
        0.25,
        "sampling intervals below which a lag cannot be told from a dead time as long",
        "the weak form integrates in four steps per sample",
        off=0.0,
    )
    nearly_noise: float = _field(
        2.0, "largest mean square of an equation for which several effects are named", _DEVELOPMENT, off=0.0
    )
    most_equivalent: int = _field(
        4,
        "largest number of equivalent effects; with more, none is identifiable",
        _DEVELOPMENT,
        off=_NO_LIMIT,
    )
    far_from_prior: float = _field(
        3.0, "standard deviations above which a parameter is far from its stated value", _LEVEL, off=_NEVER
    )
    near_prior: float = _field(
        2.0, "standard deviations within which a parameter is at its stated value", _LEVEL, off=_NEVER
    )
    return_share: float = _field(
        0.5, "fraction by which a moved parameter has to return for an effect to explain it", _DEVELOPMENT
    )
    warning_error_ratio: float = _field(
        1.05,
        "error, relative to the least, up to which an effect is named in a warning",
        _DEVELOPMENT,
        off=1.0,
    )
    far_factor: float = _field(
        3.0,
        "factor above which a parameter without standard deviation is far from its stated value",
        _DEVELOPMENT,
        off=_NEVER,
    )
    same_commands: float = _field(
        0.15,
        "largest rms difference, over their standard deviation, of repeated commands",
        "half a sample of clock error",
        off=0.0,
    )
    changed_command: float = _field(
        0.05,
        "standard deviation of a command, relative to its maximum, above which it counts as changing",
        "the eye",
    )
    same_length: float = _field(
        0.5, "fraction of the shorter run over which commands are compared", _DEVELOPMENT
    )
    manoeuvres: int = _field(20, "manoeuvres tried to separate equivalent effects", _TIME)

    # --- data ---------------------------------------------------------------------------------
    pieces: int = _field(6, "pieces that a run is cut into if no validation run is given", _DEVELOPMENT)
    validation_pieces: tuple[int, ...] = _field(
        (1, 4), "pieces set aside for validation, counted from 0", _DEVELOPMENT
    )
    piece_gap: float = _field(1.0, "gap between two pieces", "memory of the vehicle", unit="s")
    fewest_samples: int = _field(10, "least number of samples of a run that can be cut", "no piece is empty")
    whole_below: float = _field(
        0.1,
        "length, relative to the longest run, below which a run is fitted whole",
        "pieces of a push in a tank",
        off=0.0,
    )
    excitation_ratio: float = _field(
        2.0,
        "ratio to its noise above which a velocity counts as moving",
        "noise alone has a ratio of 1",
        off=0.0,
    )

    def __post_init__(self) -> None:
        if not _RATES.least <= self.false_alarm_rate <= _RATES.most:
            raise UndertowError(
                f"false alarm rate {self.false_alarm_rate:g} is out of range: choose one between "
                f"{_RATES.least:g} and {_RATES.most:g} (0.01 by default)"
            )
        if not 0.0 <= self.worth < 1.0:
            raise UndertowError(
                f"worth = {self.worth:g} is out of range: choose --worth from 0 to below 1 (0.1, a tenth, "
                "by default)"
            )

    @classmethod
    def about(cls) -> dict[str, Threshold]:
        """Description of every threshold, by its name."""
        return {f.name: f.metadata["about"] for f in fields(cls)}


DEFAULT = Settings()
