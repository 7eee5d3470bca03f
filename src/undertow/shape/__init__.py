"""What the shape of a hull says of its parameters before any test."""
