"""Estimators: weak form, instrumental variables, output error, prediction error."""
