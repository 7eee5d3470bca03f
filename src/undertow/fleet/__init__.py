"""Many vehicles, years of logs: partitions reduced side by side, then put together for each vehicle."""
