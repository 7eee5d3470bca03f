"""Manoeuvres that determine parameters best, or that best tell rival models apart."""
