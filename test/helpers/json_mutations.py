"""Edited JSON values: each value is replaced or removed in turn."""

from __future__ import annotations

from collections.abc import Iterator


def mutations(content: object) -> Iterator[object]:
    """Yield JSON values in which one value is replaced, or removed from its object.

    A value is replaced by null unless it is null, by the empty value of its own type unless it is empty, and by a
    filled value of another type.
    """
    if content is not None:
        yield None
    if content:
        yield type(content)()
    yield {"path": {}} if isinstance(content, list) else [{}]
    if isinstance(content, dict):
        for name, value in content.items():
            yield {key: item for key, item in content.items() if key != name}
            for changed in mutations(value):
                yield {**content, name: changed}
    if isinstance(content, list):
        for row, value in enumerate(content):
            for changed in mutations(value):
                yield [*content[:row], changed, *content[row + 1 :]]
