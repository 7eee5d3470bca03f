"""Logs longer than a fit takes: decimated to the vehicle's band, and their most informative segments."""
