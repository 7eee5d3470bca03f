"""Which command reads which format: every pair is run, on the dive of the tests written in that format."""
