"""Bundled vehicles: one TOML file each, with the source of every value (see README.md in this folder)."""
