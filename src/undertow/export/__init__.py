"""A vehicle in the forms that other programs read: FMU, SDF."""
