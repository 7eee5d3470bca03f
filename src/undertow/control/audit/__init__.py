"""Audits of equations: what does not fit in those of the mini-AUV paper, and in a vehicle's own."""

from .discrepancy import Discrepancy
from .paper import audit_paper
from .vehicle import audit_vehicle

__all__ = ["Discrepancy", "audit_paper", "audit_vehicle"]
