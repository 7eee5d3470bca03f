"""Time and memory of commands on logs that are longer than a fit takes."""
