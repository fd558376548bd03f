"""Publishers of a topic in a ROS graph, and the issues between a publisher and a subscriber.

Nodes, `sfr doctor` and `sfr record` report the same issues in the same words. `silence_of` checks the reasons why no
message is received in this order: the topic has no publisher; every publisher has another type; every publisher offers
less reliability than requested; no message arrives, because none is sent, because the messages were sent before the
subscription and are not latched, or because a container has a separate /dev/shm.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.issues import Cause, Issue
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.message_types import COMPRESSED, IMAGE

MUCH_LOST = 0.1  #: Fraction of lost messages above which the transport is probably not configured for large messages.
UNKNOWN_NAME = "of unknown name"  #: Name of a node that is not discovered, in messages.
COMPARABLE_NS = 60 * NS_PER_S
"""Largest difference between two clocks whose times are compared, ns. With a played recording, or on a host whose clock
is not set, the difference is larger."""


class Reliability(StrEnum):
    """Reliability of a publisher or subscriber."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


@dataclass(frozen=True, slots=True)
class Publisher:
    """A publisher of a topic as reported by the graph."""

    node: str
    """Name of the publisher's node, with its namespace."""
    msgtype: str
    reliability: Reliability = Reliability.RELIABLE
    is_latched: bool = False  #: Whether its last messages are kept for late subscribers.


def silence_of(
    topic: str,
    wanted: Sequence[str],
    publishers: Sequence[Publisher],
    requested: Reliability = Reliability.BEST_EFFORT,
    *,
    heard: Collection[str] = (),
) -> Issue:
    """Return why no message of one of the wanted types is received on a topic, and the fix.

    `heard` are the nodes from which other messages are received, so that the transport is not the reason.
    """
    if not publishers:
        fix = "start the publisher, or remap its topic (sfr run -r EXPECTED:=FOUND)"
        return Issue(Cause.NO_PUBLISHER, topic, "no publisher", fix)
    of_type = [publisher for publisher in publishers if publisher.msgtype in wanted]
    if not of_type:
        return wrong_type(topic, wanted, [publisher.msgtype for publisher in publishers])
    names = ", ".join(sorted({publisher.node for publisher in of_type}))
    offered = {publisher.reliability for publisher in of_type}
    if requested is Reliability.RELIABLE and offered == {Reliability.BEST_EFFORT}:
        text = f"the publisher {names} offers best_effort but reliable is requested: nothing is received"
        override = f"qos_overrides.{topic}.subscription.reliability"
        fix = f"set the parameter {override} of the node, or for images and poses its parameter input.reliability, to "
        fix += "best_effort, or let the publisher offer reliable"
        return Issue(Cause.QOS, topic, text, fix)
    text = f"the publisher {names} exists, but no message was received"
    fix = "check whether the publisher sends messages; "
    if any(publisher.node in heard and publisher.node != UNKNOWN_NAME for publisher in of_type):
        fix += "a message that was sent before the subscription is received only if it is latched (transient_local)"
    else:
        fix += "a container with --net=host also requires --ipc=host to share /dev/shm"
    return Issue(Cause.SILENT, topic, text, fix)


def wrong_type(topic: str, wanted: Sequence[str], types: Iterable[str]) -> Issue:
    """Return the issue of a topic that has other types than those wanted."""
    found = ", ".join(sorted(set(types)))
    text = f"the type is {found}: {alternatives(wanted)} is required"
    return Issue(Cause.WRONG_TYPE, topic, text, _fix_of_type(topic, wanted, found))


def doubled_publishers(topic: str, publishers: Sequence[Publisher]) -> Issue | None:
    """Return the issue of a topic whose several publishers are mixed; None if there is at most one."""
    if len(publishers) < 2:
        return None
    names = ", ".join(sorted(publisher.node for publisher in publishers))
    text = f"{len(publishers)} publishers ({names})"
    fix = "stop all but one (a killed node stays visible for up to 20 s)"
    return Issue(Cause.SEVERAL_PUBLISHERS, topic, text, fix, is_blocking=False)


def _fix_of_type(topic: str, wanted: Sequence[str], found: str) -> str:
    """Return the fix for a wrong type. Raw and compressed images require topics of different names."""
    if found == COMPRESSED and IMAGE in wanted:
        return f"name the topic of compressed images EXPECTED/compressed: sfr run -r EXPECTED/compressed:={topic}"
    if found == IMAGE and COMPRESSED in wanted:
        return f"name the topic of raw images without /compressed: sfr run -r EXPECTED:={topic}"
    return "publish the required type, or remap another topic (sfr run -r EXPECTED:=FOUND)"


def loss_fix(export_line: str) -> str:
    """Return the fix for messages that are lost between two processes of a host."""
    return (
        f"start the process that publishes them (the camera driver) with `{export_line}`: the default shared memory "
        "of the publisher is 0.5 MB; a container with --net=host requires --ipc=host"
    )
