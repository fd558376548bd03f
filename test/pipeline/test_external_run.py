"""An external node: each answer counted once, each fault by its name; what its processes used."""

from __future__ import annotations

import subprocess
import sys
import time

import psutil
import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.pipeline.external_run import ProcessWatch, processes_named

SIZE = 60_000_000
CHILD = f"import sys; data = bytearray({SIZE}); data[::4096] = bytes(len(data[::4096])); print('there', flush=True); "
CHILD += "n = sum(range(3_000_000)); sys.stdin.read()"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {CHILD!r}, 'a-mark-of-its-own'])"


def test_a_child_is_counted_with_its_parent_and_a_name_finds_it() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as parent:
        watch = ProcessWatch([parent.pid], period_s=0.01)
        watch.start()
        parent.stdout.readline()
        (child,) = psutil.Process(parent.pid).children()
        assert child.pid in processes_named("a-mark-of-its-own")
        assert processes_named(str(parent.pid)) == [parent.pid]
        with pytest.raises(ConfigError, match="there is no such process"):
            processes_named("no process has this name, has it")
        time.sleep(0.1)
        parent.stdin.close()
        watch.stop()
        watch.stop()
    usage = watch.usage
    assert usage.processes == 2
    assert SIZE < usage.peak_rss_bytes < SIZE + 100_000_000
    assert 0.01 < usage.cpu_s < 30.0
