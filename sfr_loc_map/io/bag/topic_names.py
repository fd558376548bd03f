"""The names of the topics of a bag: as recorded, and as the suite reads them."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.topics import names

TOPICS_READ = tuple(name.strip("/") for name in names(read=True))
"""Names of the topics that are read from a bag, in any namespace."""


@dataclass(frozen=True, slots=True)
class TopicNames:
    """The name in the suite of each topic of a bag."""

    by_topic: Mapping[str, str]  #: Name in the suite by name in the bag: the name in the bag itself unless renamed.

    @classmethod
    def of(cls, recorded: Collection[str], topics: Mapping[str, str], path: Path) -> TopicNames:
        """Return the names of the `recorded` topics of the bag `path`; `topics` is `SourceConfig.topics`.

        InputError if the bag does not have one of `topics`; ConfigError if no topic is read under one of their names.
        """
        wanted = {topic.strip("/"): name.strip("/") for name, topic in topics.items()}
        own = {topic: topic.strip("/") for topic in recorded}
        for old, new in wanted.items():
            if old not in own.values():
                if new in own.values() and _is_read(old):
                    raise ConfigError(
                        f"bag '{path}' has no topic '{old}' to remap to '{new}', but has a topic '{new}': "
                        f"exchange both names (--remap {new}:={old}, or {old}: {new} in the section topics)"
                    )
                raise InputError(
                    f"bag '{path}' has no topic '{old}' to remap to '{new}': {_near(old, sorted(recorded))};",
                    "correct this name",
                )
            if not _is_read(new):
                raise ConfigError(
                    f"'{old}' of bag '{path}' is remapped to '{new}', but no topic is read as '{new}': "
                    f"{_near(new, TOPICS_READ)}; correct this name"
                )
        return cls({topic: wanted.get(name, name) for topic, name in own.items()})

    def matching(self, name: str) -> list[str]:
        """Return the names in the bag of the topics that match a name; a relative name matches in any namespace."""
        if name.startswith("/"):
            return [topic for topic in self.by_topic if topic.strip("/") == name.strip("/")]
        exact = [topic for topic, new in self.by_topic.items() if new == name]
        return exact or [topic for topic, new in self.by_topic.items() if new.endswith(f"/{name}")]

    def namespaces(self) -> dict[str, list[str]]:
        """Return, by namespace, the names of `TOPICS_READ` that exactly one topic has without being remapped."""
        found: dict[str, list[str]] = {}
        for name in TOPICS_READ:
            topics = self.matching(name)
            if len(topics) == 1 and (topic := topics[0].strip("/")).endswith(f"/{name}"):
                found.setdefault(topic.removesuffix(name).rstrip("/"), []).append(name)
        return found


def _is_read(name: str) -> bool:
    """Return whether a topic with this name is read, in any namespace."""
    return any(f"/{name}".endswith(f"/{read}") for read in TOPICS_READ)


def _near(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, [item.strip("/") for item in known], n=3)
    return (f"did you mean {alternatives(near)}? " if near else "") + f"the topics are {', '.join(known)}"
