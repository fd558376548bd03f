"""States and steps that a recorded node said on /diagnostics are those of the bag's estimates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.io.bag_messages import header, odometry
from sfr_loc_map.pipeline.bag_estimates import DIAGNOSTICS
from sfr_loc_map.pipeline.scoring import load_estimates

STEP = np.random.default_rng(0).normal(size=27) / 3.0


def status(name: str, **values: object) -> object:
    """Return a status as nodes write them."""
    types = TYPESTORE.types
    pairs = [types["diagnostic_msgs/msg/KeyValue"](key, str(value)) for key, value in values.items()]
    return types["diagnostic_msgs/msg/DiagnosticStatus"](0, name, "", "host", pairs)


def call(node: str, stamp_ns: object, state: str, **more: object) -> object:
    """Return the status of a call."""
    return status(f"{node}: call", task="localisation", stamp_ns=stamp_ns, state=state, processing_time_s=0.1, **more)


def recorded(path: Path, *statuses: object, namespace: str = "/rover") -> Path:
    """Write a bag with three estimates and these statuses."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        poses = writer.add_connection(
            f"{namespace}/localisation/odometry", "nav_msgs/msg/Odometry", typestore=TYPESTORE
        )
        told = writer.add_connection("/diagnostics", DIAGNOSTICS, typestore=TYPESTORE)
        for stamp_ns in (1, 2, 3):
            message = odometry(stamp_ns, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
            writer.write(poses, stamp_ns, TYPESTORE.serialize_cdr(message, "nav_msgs/msg/Odometry"))
        for item in statuses:
            array = TYPESTORE.types[DIAGNOSTICS](header(1, ""), [item])
            writer.write(told, 3, TYPESTORE.serialize_cdr(array, DIAGNOSTICS))
    return path


def test_a_bag_has_the_states_and_steps_of_its_node(tmp_path: Path) -> None:
    text = " ".join(map(repr, STEP.tolist()))
    bag = recorded(
        tmp_path / "bag",
        call("rover/localisation_node", 1, "tracking"),
        call("rover/localisation_node", 3, "degraded", step=text),
        call("other/localisation_node", 2, "degraded", step=text),
        status("rover/localisation_node: summary", task="localisation"),
        status("rover/mapping_node: call", task="mapping", stamp_ns=2, state="degraded", processing_time_s=1),
    )
    found = load_estimates(bag)
    assert found.degraded.tolist() == [False, False, True]
    assert found.steps is not None
    np.testing.assert_array_equal(found.steps, [np.full(27, np.nan)] * 2 + [STEP])


def test_a_bag_without_calls_knows_neither_states_nor_steps(tmp_path: Path) -> None:
    found = load_estimates(recorded(tmp_path / "bag", namespace=""))
    assert not found.degraded.any()
    assert found.steps is None


def test_a_call_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'localisation_node: call' of '/diagnostics'"):
        load_estimates(recorded(tmp_path / "bag", call("localisation_node", "later", "tracking"), namespace=""))
