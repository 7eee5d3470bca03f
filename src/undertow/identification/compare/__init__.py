"""Comparing a model with logs: where it fails, by how much, and how much of that is noise."""
