"""The Dask workers that run the jobs.

cluster.py         connects to Dask, selects the workers with the code of the client, and gives them the jobs
worker_start.py    Dask imports this module when a worker starts
"""
