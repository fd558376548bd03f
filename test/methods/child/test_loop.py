"""The loop in the process of a method: copies of the images, and a reply to each order."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.methods.registry import CHILD

ADAPTER = """
import time

import numpy as np

class Method:
    version = "7"
    maps_sets = True

    def __init__(self):
        self.kept = []

    def prepare(self, left, right, order):
        self.kept.append(left)
        def call():
            if order["since_start_s"] < 0.0:
                raise ValueError("no texture")
            time.sleep(0.1)
            return left.shape, float(right.mean())
        return call

    def report(self, answer, order):
        if answer is None:
            raise RuntimeError("a call that raised has no result")
        if order["pairs"][0].get("stamp_ns"):
            return {"stamp_ns": np.int64(order["pairs"][0]["stamp_ns"])}
        if order["call"] == "invalid":
            return {"state": {1}}
        return {"shape": answer[0], "right": answer[1], "first_kept": float(self.kept[0].mean())}

def open_method(setup):
    return Method()
"""


@pytest.mark.clause("4.2.1")
def test_a_method_gets_copies_of_each_pair_and_every_order_is_answered(tmp_path: Path) -> None:
    (tmp_path / "adapter.py").write_text(ADAPTER)
    images = np.memmap(tmp_path / "images", np.uint8, "w+", shape=(3, 2, 4, 6))
    images[:, 0], images[:, 1] = 10, 20
    with subprocess.Popen(
        [sys.executable, str(CHILD / "loop.py"), str(tmp_path / "adapter.py")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None

        def answer(order: object) -> dict[str, object]:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
            return dict(json.loads(process.stdout.readline() or "{}"))

        assert json.loads(process.stdout.readline()) == {"adapter": "adapter.py"}
        setup = {"search_path": [], "images": str(tmp_path / "images"), "camera": {"width": 6, "height": 4}}
        one = {"number": 5, "call": "pair", "pairs": [{}], "since_start_s": 0.0}
        assert answer(setup) == {"version": "7", "fuses": False, "maps_sets": True}
        first = answer(one)
        assert first["result"] == {"shape": [4, 6], "right": 20.0, "first_kept": 10.0}
        assert 0.1 <= float(str(first["seconds"])) < 5.0
        images[:] = 99
        assert answer(one)["result"] == {"shape": [4, 6], "right": 99.0, "first_kept": 10.0}
        assert answer({**one, "since_start_s": -1.0}) == {
            "number": 5,
            "fault": "raised",
            "text": "ValueError: no texture",
        }
        several = answer({**one, "call": "set", "pairs": [{}, {}, {}]})
        assert several["result"] == {"shape": [3, 4, 6], "right": 99.0, "first_kept": 10.0}
        assert answer({**one, "pairs": [{"stamp_ns": 3}]})["result"] == {"stamp_ns": 3}
        assert answer({**one, "call": "invalid"})["fault"] == "invalid result"
        process.stdin.close()
        assert process.wait(10) == 0
