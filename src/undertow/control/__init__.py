"""Control laws, conditions on their gains, closed loops and linear analysis."""
