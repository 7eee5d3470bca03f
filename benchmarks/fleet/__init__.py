"""A fleet on Dask: a run to look at, what it costs, and what very many rows would."""
