"""Many vehicles, years of logs: partitions reduced in parallel, then combined for each vehicle."""
