"""Formats that vehicles write: one format is one module with a `FORMAT`; `fieldlog` finds them."""
