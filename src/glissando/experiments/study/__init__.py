"""Studies: what comes of every combination of settings, over many seeds, on any Dask cluster."""
