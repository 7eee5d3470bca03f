"""From residuals to a verdict: which effect is missing, that none is, or that none explains the residual."""
