"""Mistakes in logs, and in how they are read, before physics is blamed for them."""
