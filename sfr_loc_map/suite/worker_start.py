"""What a worker process of Dask does first (`distributed.worker.preload`)."""

import signal

from sfr_loc_map.suite import job_run

assert job_run  # imported now, so that the time of the first job does not count it
# Ctrl-C goes to all processes of a terminal; the client ends the workers. Ignored signals would be inherited.
signal.signal(signal.SIGINT, lambda *_: None)
