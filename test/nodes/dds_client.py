"""A DDS client that knows nothing of ROS: dds_client.py DOMAIN SECONDS; prints what comes as JSON, a line each."""

import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Float64(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):
    data: float64


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


def main() -> None:
    participant = DomainParticipant(int(sys.argv[1]))
    reliable = Policy.Reliability.Reliable(duration(seconds=1))
    qos = Qos(reliable, Policy.History.KeepLast(100))
    latched = Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    readers = {
        "odometry": DataReader(participant, Topic(participant, "rt/localisation/odometry", Odometry), qos=qos),
        "position": DataReader(participant, Topic(participant, "rt/metrics/position/mean", Float64), qos=qos),
        "report": DataReader(participant, Topic(participant, "rt/metrics/report", String), qos=latched),
    }
    end = time.monotonic() + float(sys.argv[2])
    while time.monotonic() < end:
        for name, reader in readers.items():
            for sample in reader.take(100):
                print(json.dumps({"topic": name, **_values(sample)}), flush=True)
        time.sleep(0.02)


def _values(sample: Odometry | Float64 | String) -> dict[str, object]:
    if not isinstance(sample, Odometry):
        return {"data": sample.data}
    place, turn, stamp = sample.pose.pose.position, sample.pose.pose.orientation, sample.header.stamp
    return {
        "stamp_ns": stamp.sec * 1_000_000_000 + stamp.nanosec,
        "frames": [sample.header.frame_id, sample.child_frame_id],
        "position": [place.x, place.y, place.z],
        "quat": [turn.x, turn.y, turn.z, turn.w],
        "covariance": list(sample.pose.covariance),
    }


if __name__ == "__main__":
    main()
