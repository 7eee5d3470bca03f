"""Linear analysis with python-control: trims, linear systems, loops, families and designs."""
