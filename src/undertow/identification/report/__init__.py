"""The report of a diagnosis: one HTML page, its figures, and template effect files."""
