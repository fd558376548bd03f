"""What a worker process of Dask does first (`distributed.worker.preload`)."""

import signal

from sfr_loc_map.signals import END_SIGNALS
from sfr_loc_map.suite.running import job_run

assert job_run  # imported now, so that the time of the first job does not count it
# These go to all processes of a terminal; the client ends the workers. Ignored signals would be inherited.
for number in (signal.SIGINT, signal.SIGHUP):
    signal.signal(number, lambda *_: None)
signal.pthread_sigmask(signal.SIG_UNBLOCK, END_SIGNALS)  # what it starts gets them
