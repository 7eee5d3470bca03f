"""Where the time of a diagnosis goes: by stage, by module, and against the number of effects tried."""
