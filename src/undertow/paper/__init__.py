"""The mini-AUV paper's own chain: its least squares, its printed tables, its equations."""
