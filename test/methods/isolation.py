"""What isolation costs beside the timed call, at 1 MP: `python test/methods/isolation.py [PAIRS]`.

The wall time of `IsolatedMethod.localise` minus the time of the call by the clock of the method's process. Between the
calls images are decoded, as in a run; the method itself does nothing, or works for 20 ms on 32 MB, so that all that the
next pair needs has left the caches.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import Task
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.registry import find_method

METHODS = """
import time
import numpy as np


class Nothing:
    work_s = 0.0
    def __init__(self, rig, config):
        self.numbers = np.zeros(4_000_000)

    def process(self, pair):
        end_s = time.perf_counter() + self.work_s
        while time.perf_counter() < end_s:
            self.numbers += float(pair.left.max())
        return np.eye(4)


class Work(Nothing):
    work_s = 0.02
"""
RIG = StereoRig(1024, 1024, 800.0, 800.0, 511.5, 511.5, 0.3, Transform.identity())


def main(pairs: int = 300) -> None:
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    noise = [cv2.GaussianBlur(rng.integers(0, 255, (1024, 1024), np.uint8), (9, 9), 3) for _ in range(6)]
    encoded = [cv2.imencode(".png", image)[1] for image in noise]
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "methods.py").write_text(METHODS, encoding="utf-8")
        for name in ("Nothing", "Work"):
            outside_ms = []
            with IsolatedMethod(find_method(f"{folder}/methods.py:{name}", Task.LOCALISATION), RIG) as localiser:
                for number in range(pairs):
                    sides = (cv2.imdecode(encoded[(number + k) % 6], cv2.IMREAD_GRAYSCALE) for k in (0, 1))
                    pair, begin = StereoPair(number, *sides), time.perf_counter()
                    _, call = localiser.localise(pair)
                    outside_ms.append(1e3 * (time.perf_counter() - begin - call.usage.processing_time_s))
                    assert not call.finding, call.finding
            low, middle, high = np.percentile(outside_ms, (0, 50, 95))
            print(f"{name}: p50 {middle:.2f} ms, p95 {high:.2f} ms, least {low:.2f} ms")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
