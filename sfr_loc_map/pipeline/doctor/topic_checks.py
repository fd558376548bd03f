"""Checks of the bag as a whole and of each topic: names, publishers, types, quality of service."""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.constants import SIDES
from sfr_loc_map.io.bag import COMPRESSED, IMAGE
from sfr_loc_map.pipeline.doctor.finding import Cause, Finding, blocking, warning
from sfr_loc_map.pipeline.doctor.observation import Observation, ObservedTopic, Reliability, allowed_types


def check_readable(seen: Observation) -> Iterator[Finding]:
    """Yield whether a bag is broken or was not closed."""
    if seen.broken:
        yield blocking(Cause.BROKEN, seen.subject, seen.broken, "record or copy it again; what is whole can be read")
    if seen.unfinished:
        yield warning(
            Cause.UNFINISHED,
            seen.subject,
            "its recording was not finished: it has no end record",
            "nothing needs to be done here; for other readers rewrite it: sfr convert",
        )


def check_names(seen: Observation) -> Iterator[Finding]:
    """Yield names that several topics could have, and whether no topic has an expected name."""
    for name, found in seen.ambiguous.items():
        yield blocking(
            Cause.AMBIGUOUS,
            name,
            f"several topics could be it: {', '.join(found)}",
            "choose a rover by --namespace, or one topic by --remap FOUND:=EXPECTED",
        )
    if not seen.tasks and not seen.ambiguous:
        images = [n for n, types in sorted(seen.others.items()) if {IMAGE, COMPRESSED} & set(types)]
        there = f"topics with images are {', '.join(images)}" if images else "no topic has images"
        yield blocking(
            Cause.NO_TOPIC,
            seen.subject,
            f"neither loc/left/image_rect nor nav/left/image_rect is there; {there}",
            "name them by --remap FOUND:=EXPECTED, or start the cameras" if seen.live else "--remap FOUND:=EXPECTED",
        )


def check_camera_topics(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield issues of the topics of images and camera_info of a task."""
    for side in SIDES:
        yield from check_topic(seen, task, f"{task}/{side}/image_rect", seen.images(task, side))
        name = f"{task}/{side}/camera_info"
        yield from check_topic(seen, task, name, seen.topics.get(name))


def check_topic(seen: Observation, task: str, name: str, topic: ObservedTopic | None) -> Iterator[Finding]:
    """Yield issues of one topic that a task needs.

    Args:
        seen: What was observed.
        task: Task whose node subscribes to it; empty for none.
        name: The suite's name of the topic.
        topic: The topic, None where it is absent.
    """
    if name in seen.ambiguous:
        return
    if topic is None or not topic.offers:
        yield _absent(seen, topic.found if topic is not None else f"{seen.prefix}{name}")
    elif set(topic.types) - set(allowed_types(name)):
        yield _wrong_type(name, topic)
    else:
        if seen.live and _requested(seen, task) is Reliability.RELIABLE and Reliability.BEST_EFFORT in topic.offers:
            yield blocking(
                Cause.QOS,
                topic.found,
                "its publisher offers best_effort, reliable is requested: nothing is received",
                "set input.reliability to best_effort, or the publisher's to reliable",
            )
        if not topic.messages:
            yield _silent(seen, topic)


def _absent(seen: Observation, name: str) -> Finding:
    hint = "or name it by --remap FOUND:=EXPECTED"
    if seen.live:
        return blocking(Cause.NO_PUBLISHER, name, "it has no publisher", f"start its publisher, {hint}")
    return blocking(Cause.NO_TOPIC, name, "it is not in the bag", f"record it, {hint}")


def _wrong_type(name: str, topic: ObservedTopic) -> Finding:
    allowed = allowed_types(name)
    wrong = [kind for kind in topic.types if kind not in allowed]
    return blocking(
        Cause.WRONG_TYPE,
        topic.found,
        f"its type is {', '.join(wrong)}: {' or '.join(allowed)} is needed",
        "publish the right type, or name another topic by --remap FOUND:=EXPECTED",
    )


def _silent(seen: Observation, topic: ObservedTopic) -> Finding:
    if seen.live:
        return blocking(Cause.SILENT, topic.found, "no message was received", "check its publisher")
    return blocking(Cause.SILENT, topic.found, "it has no message", "record it again")


def _requested(seen: Observation, task: str) -> Reliability:
    node = seen.node(task)
    return node.reliability if node is not None else Reliability.RELIABLE
