"""Plans the jobs of a suite and runs them on Dask. Each result is a file named by a hash of its inputs."""
