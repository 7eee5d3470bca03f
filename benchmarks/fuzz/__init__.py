"""Damaged files: every reader and command gives an answer or refuses in one line."""
