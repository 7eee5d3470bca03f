"""The catalogue: every module in this folder is one effect, found by discovery."""
