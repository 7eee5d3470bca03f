"""The report of a diagnosis: one HTML page, the pictures in it, and effect files to begin with."""
