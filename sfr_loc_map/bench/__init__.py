"""Benchmarks of several methods, or of single faults, which run sequentially without Dask."""
