"""A candidate with the evidence for it."""

from __future__ import annotations

from dataclasses import dataclass

from .evidence import Comparison
from .trial import Trial


@dataclass(frozen=True)
class Finding:
    """A candidate with the evidence for it.

    Attributes
    ----------
    trial : Trial
        The candidate after its fit.
    evidence : Comparison
        Fall of the kept-aside error, block by block.
    explained : float
        Share of what exceeds the noise that it takes away.
    p_value : float
        Chance that the best of all candidates lowers the error as much when nothing is missing.
    significant : bool
        Whether it is held to be there.
    inclusion : float
        How often it is the best one when the blocks of the logs are drawn anew; NaN if not compared.
    """

    trial: Trial
    evidence: Comparison
    explained: float
    p_value: float
    significant: bool
    inclusion: float = float("nan")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters that its fit brings into the model."""
        free = self.trial.fit.model.free
        return tuple(p.name for p in self.trial.candidate.parameters if p.name in free)

    @property
    def id(self) -> str:
        """Id of the effect."""
        return self.trial.id
