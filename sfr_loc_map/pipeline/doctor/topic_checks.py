"""Checks of the bag as a whole and of each topic: names, publishers, types, quality of service."""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io.bag import COMPRESSED, IMAGE
from sfr_loc_map.io.bag_sequence import RAW, RECTIFIED
from sfr_loc_map.pipeline.doctor.finding import Cause, Finding, Severity, blocking, warning
from sfr_loc_map.pipeline.doctor.observation import Observation, ObservedTopic, Reliability, allowed_types
from sfr_loc_map.pipeline.online.transport_gaps import MUCH_LOST, loss_fix

FEW_LOST = 0.01
"""Share of images lost in transport above which there is a warning."""


def check_readable(seen: Observation) -> Iterator[Finding]:
    """Yield whether a bag or source is broken, was not closed or lacks files."""
    if seen.broken:
        fix = "correct or copy the file again" if seen.files else "record or copy it again; what is whole can be read"
        yield blocking(Cause.BROKEN, seen.subject, seen.broken, fix)
    if seen.left_out:
        yield warning(
            Cause.MISSING_IMAGES,
            seen.subject,
            f"{seen.left_out} pairs are listed whose images are not there: they are left out",
            "restore the files, or take the pairs out of the list",
        )
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
            f"neither loc/left/image_rect nor nav/left/image_rect is there (nor image_raw); {there}",
            "name them by --remap FOUND:=EXPECTED, or start the cameras" if seen.live else "--remap FOUND:=EXPECTED",
        )


def check_camera_topics(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield issues of the topics of images and camera_info of a task."""
    for side in SIDES:
        yield from check_topic(seen, f"{task}/{side}/{seen.image_name(task)}", seen.images(task, side))
        name = f"{task}/{side}/camera_info"
        yield from check_topic(seen, name, seen.topics.get(name))
    node = seen.node(task)
    if seen.is_idle(task) and not (node is not None and node.has_worked):
        end = "watch until a pair comes (--seconds)" if seen.live else "record it again, if there should be pairs"
        yield warning(Cause.SILENT, seen.both_images(task), "no pair came meanwhile", end)


def check_transport(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield whether images of a task are lost on the way from their publishers."""
    share = seen.lost_share(task)
    if share > FEW_LOST:
        yield Finding(
            Cause.TRANSPORT,
            Severity.BLOCKING if share > MUCH_LOST else Severity.WARNING,
            seen.both_images(task),
            f"{share:.0%} of the images are lost between their publisher and this process",
            loss_fix(seen.memory.export_line),
        )


def check_topic(seen: Observation, name: str, topic: ObservedTopic | None) -> Iterator[Finding]:
    """Yield issues of one topic that a task needs.

    Args:
        seen: What was observed.
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
        strict = [node for node, requested in topic.requests.items() if requested is Reliability.RELIABLE]
        if strict and Reliability.BEST_EFFORT in topic.offers:
            yield blocking(
                Cause.QOS,
                topic.found,
                f"its publisher offers best_effort, {', '.join(strict)} requests reliable: nothing is received",
                f"set qos_overrides.{topic.found}.subscription.reliability of the node to best_effort (or "
                f"input.reliability), or the publisher's to reliable",
            )
        if not topic.messages and not seen.is_idle(name.partition("/")[0]):
            yield _silent(seen, topic)


def _absent(seen: Observation, name: str) -> Finding:
    hint = "or name it by --remap FOUND:=EXPECTED"
    if name.endswith(RECTIFIED) and name.removesuffix(RECTIFIED) + RAW in seen.others:
        hint = f"or set input.rectify of the node: {RAW} is there"
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
