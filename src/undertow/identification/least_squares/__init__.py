"""The paper's chain: Savitzky–Golay filters, then ordinary least squares on the samples.

A baseline: filtering the motion and not the force biases the estimates (`undertow fit` has no such bias).
"""

from .cases import CASES, Case, Smoother, chosen_cases
from .chain import RULE, Estimation, Experiment, estimate, experiments, selected
from .chosen import Chosen, chosen

__all__ = [
    "CASES",
    "RULE",
    "Case",
    "Chosen",
    "Estimation",
    "Experiment",
    "Smoother",
    "chosen",
    "chosen_cases",
    "estimate",
    "experiments",
    "selected",
]
