"""State estimation: Kalman filters and smoothers that follow from a vehicle, and tests of their honesty."""
