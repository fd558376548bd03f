"""Python types of messages by the names that ROS gives them."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from sfr_loc_map.errors import NodeError
from sfr_loc_map.io.bag import TYPESTORE

UNKNOWN_HASH = "RIHS01_unknown"


def message_type(msgtype: str) -> type[Any]:
    """Return the type of a name such as `sensor_msgs/msg/Image`; raises NodeError if its package is not installed."""
    package, _, name = msgtype.split("/")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise NodeError(f"messages of type {msgtype} are not known here: install or source {package}") from error
    return found


def definition_of(msgtype: str) -> tuple[str, str]:
    """Return the text of a type with those within it, as bags have it, and its hash (RIHS01).

    Types that the bag library does not know are read from their package; text and hash are empty words where that
    fails, and readers then need the package.
    """
    try:
        store = TYPESTORE if msgtype in TYPESTORE.fielddefs else _with_package(msgtype)
        text, _ = store.generate_msgdef(msgtype, ros_version=2)
        return text, store.hash_rihs01(msgtype)
    except Exception:  # of an unusual definition the library raises what it likes; the messages are worth more
        return "", UNKNOWN_HASH


def _with_package(msgtype: str) -> Typestore:
    """Return a store that knows a type of an installed package and all types within it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    missing = [msgtype]
    while missing:
        name = missing.pop()
        if name in store.fielddefs:
            continue
        package, kind, short = name.split("/")
        file = Path(get_package_share_directory(package)) / kind / f"{short}.msg"
        types = get_types_from_msg(file.read_text(encoding="utf-8"), name)
        missing += [inner for _, fields in types.values() for field in fields for inner in _names_in(field[1])]
        store.register(types)
    return store


def _names_in(descriptor: Any) -> list[str]:  # noqa: ANN401 - nested tuples of the bag library
    """Return the names of types in the description of a field."""
    kind, value = descriptor
    if kind == Nodetype.NAME:
        return [value]
    return _names_in(value[0]) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else []
