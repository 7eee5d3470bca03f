"""Logs longer than a fit takes: thinned to the vehicle's band, and the segments of them that tell most."""
