"""Reading measured runs from files, and body velocities from pose where a log has only pose."""
