"""State estimation: Kalman filters and smoothers derived from a vehicle, and tests of their consistency."""
