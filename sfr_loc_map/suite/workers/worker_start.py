"""Initialisation of a Dask worker process (`distributed.worker.preload`)."""

import signal

from sfr_loc_map.signals import END_SIGNALS
from sfr_loc_map.suite.jobs import job_run

assert job_run  # imported here, so that the time of the first job does not include the import
# A terminal sends these signals to all processes, but only the client stops workers. SIG_IGN would be inherited.
for number in (signal.SIGINT, signal.SIGHUP):
    signal.signal(number, lambda *_: None)
signal.pthread_sigmask(signal.SIG_UNBLOCK, END_SIGNALS)  # child processes receive them
