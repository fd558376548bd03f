"""A DDS client without ROS: `python -m helpers.dds_client DOMAIN SECONDS` prints each message as a line of JSON."""

import json
import sys
import time
from dataclasses import asdict
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.types import array, float64, int32, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


def struct(name: str, **fields: Any) -> type[IdlStruct]:
    package, short = name.split("/")
    return make_idl_struct(short, f"{package}::msg::dds_::{short}_", fields)


AXES = dict.fromkeys("xyz", float64)
POINT, VECTOR = struct("geometry_msgs/Point", **AXES), struct("geometry_msgs/Vector3", **AXES)
POSE = struct("geometry_msgs/Pose", position=POINT, orientation=struct("geometry_msgs/Quaternion", **AXES, w=float64))
TWIST = struct("geometry_msgs/Twist", linear=VECTOR, angular=VECTOR)
ODOMETRY = struct(
    "nav_msgs/Odometry",
    header=struct("std_msgs/Header", stamp=struct("builtin_interfaces/Time", sec=int32, nanosec=uint32), frame_id=str),
    child_frame_id=str,
    pose=struct("geometry_msgs/PoseWithCovariance", pose=POSE, covariance=array[float64, 36]),
    twist=struct("geometry_msgs/TwistWithCovariance", twist=TWIST, covariance=array[float64, 36]),
)


def main() -> None:
    participant = DomainParticipant(int(sys.argv[1]))
    reliable = Policy.Reliability.Reliable(duration(seconds=1))
    qos = Qos(reliable, Policy.History.KeepLast(100))
    reader = DataReader(participant, Topic(participant, "rt/localisation/odometry", ODOMETRY), qos=qos)
    end = time.monotonic() + float(sys.argv[2])
    while time.monotonic() < end:
        for sample in reader.take(100):
            print(json.dumps(asdict(sample)), flush=True)
        time.sleep(0.02)


if __name__ == "__main__":
    main()
