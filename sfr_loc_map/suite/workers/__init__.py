"""The Dask workers that run the jobs.

cluster.py         in the client: connects to Dask, selects the workers with the code of the client, gives them the jobs
worker.py          in a worker: reports the code of the worker, and runs a job with its time limit
worker_start.py    in a worker: Dask imports this module when the worker starts, which defines the effect of signals
"""
