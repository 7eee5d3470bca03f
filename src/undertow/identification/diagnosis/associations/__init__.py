"""What a residual force goes with: variables, a period, time, the run. Associations, never causes."""
