"""Benchmarks that run one drive after the other without Dask: several methods, or one fault at a time."""
