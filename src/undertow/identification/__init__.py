"""From logs and a vehicle to estimates, comparisons and diagnoses."""
