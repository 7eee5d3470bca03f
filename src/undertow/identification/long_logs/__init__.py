"""Logs longer than a fit takes: decimated to the vehicle's band, and the segments of them that tell most."""
