"""Conditions on gains, evaluated on the expressions of the model itself."""
