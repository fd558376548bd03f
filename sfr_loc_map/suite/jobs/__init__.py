"""A job of a suite: its inputs, its identities, its work, and its outcome.

sources.py           the kinds of sources
configurations.py    parameters of localiser and mapper, or methods under test in their place
job.py               Job, and the hashes by which jobs are identified
job_run.py           the work of a job on a worker: source to score
  source_cache.py    renders simulations and fetches remote sources, once for all jobs
job_outcome.py       result or failure of a job
digests.py           hashes of values, files and code
"""
