"""Conditions on gains, evaluated on the expressions of the model itself."""

from .condition import FORMS, Condition, Signs
from .declared import CONDITIONS

__all__ = ["CONDITIONS", "FORMS", "Condition", "Signs"]
