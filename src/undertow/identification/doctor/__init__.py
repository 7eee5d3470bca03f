"""Mistakes in logs, and in how they are read, before the model is blamed for them."""
