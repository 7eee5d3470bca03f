"""The tables of docs/results.md, and how tables and numbers are written on every page."""
