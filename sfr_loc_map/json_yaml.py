"""JSON and YAML from outside: plain values whose nesting, number and length are bounded.

A rejected text raises the error that the parser itself would raise (`ValueError`, `yaml.YAMLError`). `inputs` reads the
files.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
import yaml

T = TypeVar("T")

MAX_DEPTH = 64  #: Maximum nesting depth of JSON and YAML.
MAX_NODES = 100_000  #: Maximum number of values of a YAML file after expansion of its aliases.
MAX_DIGITS = 20
"""Maximum length of an integer in JSON and YAML: a signed 64-bit integer has up to 19 digits and a sign."""
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]|[\ud800-\udfff]")
_INTEGER = re.compile(r"[-+]?(?:0b[01_]+|0x[0-9a-fA-F_]+|[0-9][0-9_]*)$")
_DECIMAL = re.compile(r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*|\.(?:inf|Inf|INF))$|\.(?:nan|NaN|NAN)$")
_EXPONENT = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$")
"""Plain scalars that are numbers. Unlike in YAML 1.1, `1:30` is a string (in base 60, it would be 90), and `1e-3` is a
number, as in YAML 1.2 and in other programs."""


def parse_json(text: str | bytes, parse_constant: Callable[[str], Any] | None = None) -> Any:  # noqa: ANN401 - any JSON
    """Return the value of a JSON text; `parse_constant` is called with NaN and Infinity, which are not JSON.

    Raises ValueError if the text is not JSON, is nested too deeply, or contains an integer of more than `MAX_DIGITS`
    characters or half of a surrogate pair, which cannot be encoded.
    """
    text = text.decode("utf-8") if isinstance(text, bytes) else text
    try:
        value = json.loads(text, parse_constant=parse_constant, parse_int=_integer)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    level: list[Any] = [[value]]
    for _ in range(MAX_DEPTH + 1):  # callers may process the value recursively
        items = (item for part in level for item in (part.values() if isinstance(part, dict) else part))
        level = [item for item in items if isinstance(item, (dict, list))]
    if level:
        raise ValueError("it is nested too deeply")
    if _SURROGATE.search(text):
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    return value


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits is too long")
    return int(text)


_KINDS = {
    **{"str": "a text", "int": "a whole number", "float": "a number", "bool": "true or false"},
    **{"array": "a list", "object": "a mapping of names to values"},
}
"""Words in our messages for the types in msgspec's messages."""
_MISSING = re.compile(r"Object missing required field `(\w+)`")
_EXPECTED = re.compile(r"Expected `(\w+)[^`]*`(?: of length ([<>]?)=? ?(\d+))?")
_LIMITS = {"": "", ">": "at least ", "<": "at most "}


def converted(content: object, kind: type[T], name: str = "") -> T:
    """Return plain values as a structure of msgspec; texts such as 1e-5 in YAML become numbers.

    Messages call the values `name`. ValueError states which value is missing, or which kind of value is
    required.
    """
    try:
        return msgspec.convert(content, kind, strict=False)
    except msgspec.ValidationError as error:
        problem, _, place = str(error).partition(" - at `$")
    place = f"{name}{place.removesuffix('`')}".lstrip(".")
    if missing := _MISSING.match(problem):
        raise ValueError(f"{'.'.join(filter(None, (place, missing[1])))} is missing")
    if expected := _EXPECTED.match(problem):
        count = f" of {_LIMITS[expected[2]]}{expected[3]} values" if expected[3] else ""
        problem = f"{_KINDS.get(expected[1], expected[1])}{count} is required"
    raise ValueError(f"{place or 'it'}: {problem}")


def parse_yaml(text: str) -> Any:  # noqa: ANN401 - any YAML
    """Return the value of a YAML text of plain types.

    Raises YAMLError or ValueError if the text is not YAML, is nested too deeply, or expands to too many values.
    """
    try:
        loader = _BoundedLoader(text)
    except yaml.reader.ReaderError as error:
        raise yaml.YAMLError(f"the character at position {error.position} is not printable") from error
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _expanded(node, {}, 0)
        return loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        raise yaml.YAMLError(_line_of(error)) from error
    except (AttributeError, TypeError, RecursionError) as error:  # the library raises them for unknown keys and tags
        raise yaml.YAMLError(f"it cannot be read: {error}") from error
    finally:
        loader.dispose()


def _line_of(error: yaml.MarkedYAMLError) -> str:
    """Return the problem with its line and column, without the context and the quoted part of the text."""
    mark = error.problem_mark or error.context_mark
    where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
    return f"{where}{error.problem or error.context}"


class _BoundedLoader(yaml.SafeLoader):
    """Loader of plain types that bounds the nesting and the length of integers."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.YAMLError("it is nested too deeply")
        node: yaml.Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:  # noqa: ANN401 - the library's
        node = super().compose_mapping_node(anchor)
        keys: set[Any] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.style is None and _EXPONENT.match(key.value):  # `1e-3` as a key is a name
                key.tag = "tag:yaml.org,2002:str"
            if key.tag == "tag:yaml.org,2002:merge":  # a mapping may merge several others
                continue
            name = self.construct_object(key)  # different texts may have the same value, such as 1 and 01
            if name in keys:  # the library would keep the last value
                raise yaml.YAMLError(f"'{key.value}' occurs twice, the second time in line {key.start_mark.line + 1}")
            keys.add(name)
        return node

    def bounded_int(self, node: yaml.ScalarNode) -> int:
        if len(node.value) > 4 * MAX_DIGITS:
            raise yaml.YAMLError(f"an integer of {len(node.value)} digits is too long")
        if node.value.lstrip("+-").isdecimal():  # `030` is 30 in YAML 1.2, 24 in 1.1
            return int(node.value)
        return int(super().construct_yaml_int(node))


_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_BoundedLoader.add_constructor(_INT, _BoundedLoader.bounded_int)
_BoundedLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in (_INT, _FLOAT)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern in ((_INT, _INTEGER), (_FLOAT, _DECIMAL), (_FLOAT, _EXPONENT)):
    _BoundedLoader.add_implicit_resolver(_tag, _pattern, list("-+.0123456789"))


def _expanded(node: yaml.Node, sizes: dict[int, int], depth: int) -> int:
    """Return the number of values of a node after expansion of its aliases; raises YAMLError if it is too large."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if depth > MAX_DEPTH:
        raise yaml.YAMLError("an alias is within its own anchor, or the file is nested too deeply")
    if id(node) not in sizes:
        pairs = node.value if isinstance(node, yaml.MappingNode) else [node.value]
        sizes[id(node)] = 1 + sum(_expanded(item, sizes, depth + 1) for pair in pairs for item in pair)
    if sizes[id(node)] > MAX_NODES:
        raise yaml.YAMLError(f"its aliases expand to more than {MAX_NODES} values")
    return sizes[id(node)]
