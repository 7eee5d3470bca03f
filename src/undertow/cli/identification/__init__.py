"""Commands that take logs."""
