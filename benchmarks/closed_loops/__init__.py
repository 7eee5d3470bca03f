"""Closed loops of the mini-AUV: the paper's run, how it depends on its reading, six degrees of freedom."""
