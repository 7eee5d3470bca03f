"""From residuals to a verdict: which effect is missing, or that none is, or that none fits."""
