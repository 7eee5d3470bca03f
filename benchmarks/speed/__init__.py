"""What undertow's compiled code costs, beside other ways to do the same on the same machine."""
