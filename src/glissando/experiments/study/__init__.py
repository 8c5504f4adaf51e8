"""Studies: errors over all combinations of settings and many seeds, on any Dask cluster."""
