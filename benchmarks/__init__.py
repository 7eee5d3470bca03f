"""Programs that measure undertow from outside; not part of the installed package."""
