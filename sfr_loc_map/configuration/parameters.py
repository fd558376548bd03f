"""Declaration of parameters as fields of frozen dataclasses, from which files and ROS parameters are derived.

The metadata of a field from `param` contain unit, range and description. `flatten` returns the dotted names that ROS
parameters and YAML files use. `build` constructs the dataclass from such names and rejects unknown names.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from sfr_loc_map.errors import ConfigError, naming_key

C = TypeVar("C")


def param(
    default: Any,  # noqa: ANN401 - the type is that of the field
    *,
    doc: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    check: Callable[[Any], object] | None = None,
) -> Any:  # noqa: ANN401 - stands for the field's value, as dataclasses.field does
    """Declare a parameter. Numbers require a range.

    `check` is called with each value and raises a ConfigError or MetricsError for an invalid value.
    """
    metadata = {"doc": doc, "unit": unit, "low": low, "high": high, "choices": choices, "check": check}
    if isinstance(default, (list, dict)):
        raise TypeError("use a tuple: defaults are shared")
    if _has_numbers(default) and (low is None or high is None or not -math.inf < low <= high < math.inf):
        raise TypeError(f"a number requires a finite range: low is {low}, high is {high} ({doc})")
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True)
class ParamInfo:
    """Dotted name and declaration of a parameter of a configuration class."""

    name: str
    type: type
    kind: str  #: The type in words.
    default: Any
    doc: str
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    check: Callable[[Any], object] | None  #: Raises a ConfigError or MetricsError for an invalid value.


def parameters(config_type: type, prefix: str = "") -> Iterator[ParamInfo]:
    """Yield every parameter of a configuration class. Nested parameters have dotted names.

    TypeError for a type that is not supported.
    """
    types = get_type_hints(config_type)
    for item in fields(config_type):
        kind = types[item.name]
        name = prefix + item.name
        if is_dataclass(kind) and isinstance(kind, type):
            yield from parameters(kind, name + ".")
            continue
        yield ParamInfo(name=name, type=kind, kind=_kind_of(kind, name), default=item.default, **item.metadata)


def flatten(
    config: Any,  # noqa: ANN401 - a mapping or configuration dataclass
    prefix: str = "",
    *,
    keeps_empty: bool = False,
) -> dict[str, Any]:
    """Return the values of a configuration, or of a nested mapping, by dotted name.

    With `keeps_empty`, an empty mapping is a value, so that its name can be checked. ConfigError if a mapping gives a
    name twice, as `a.b` and as `b` in `a`.
    """
    flat: dict[str, Any] = {}
    items = (
        config if isinstance(config, Mapping) else {item.name: getattr(config, item.name) for item in fields(config)}
    )
    for name, value in items.items():
        is_nested = isinstance(value, Mapping) or is_dataclass(value)
        if is_nested and (value or not keeps_empty):
            entries = flatten(value, f"{prefix}{name}.", keeps_empty=keeps_empty)
        else:
            entries = {f"{prefix}{name}": value}
        if twice := flat.keys() & entries.keys():
            raise ConfigError(f"'{min(twice)}' is given twice: give it once")
        flat |= entries
    return flat


def changed(config: Any, prefix: str = "") -> dict[str, Any]:  # noqa: ANN401 - any configuration dataclass
    """Return the values of a configuration that differ from the defaults, by dotted name; tuples become lists."""
    defaults = flatten(type(config)(), prefix)
    values = {name: value for name, value in flatten(config, prefix).items() if value != defaults[name]}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def is_empty(value: object) -> bool:
    """Return whether a value of a YAML file is that of a name without values: missing or an empty mapping."""
    return value is None or (isinstance(value, Mapping) and not value)


MAPPING = "a mapping of names to values"  #: The form of a section or group in a message.
_KINDS: Mapping[type, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
"""Words for the types of parameters in a message."""
_ITEMS: Mapping[type, str] = {bool: "Booleans", int: "whole numbers", float: "numbers", str: "texts"}
"""Words for the types of the items of a list in a message."""


def build(
    config_type: type[C],
    values: Mapping[str, Any],
    *,
    origin: str = "configuration",
    called: Mapping[str, str] | None = None,
) -> C:
    """Return a configuration from values by dotted or nested name; missing values have their defaults.

    Raises ConfigError, whose single line begins with `origin`, unless this is empty, and reports all faults. `called`
    has the names under which the user gave parameters, such as options, if these are not the names of the parameters.
    """
    with naming_key(origin):
        flat = flatten(values, keeps_empty=True)
    known = {info.name: info for info in parameters(config_type)}
    names = {name: name for name in known} | dict(called or {})
    groups = _groups_of(known)
    flat = {name: value for name, value in flat.items() if name not in groups or not is_empty(value)}
    problems = [
        f"'{name}' is {value!r:.40}: {MAPPING} is required"
        if name in groups
        else f"unknown key '{name}'{suggestion(name, known)}"
        for name, value in flat.items()
        if name not in known
    ]
    converted: dict[str, Any] = {}
    for name, value in flat.items():
        if name in known:
            try:
                converted[name] = _converted(known[name], value, names[name])
            except ConfigError as error:
                problems.append(str(error))
    with naming_key(origin):
        if problems:
            raise ConfigError("; ".join(problems))
        return _construct(config_type, converted, "")


def _groups_of(names: Collection[str]) -> set[str]:
    """Return the groups of parameters by dotted name: `a` and `a.b` for the name `a.b.c`."""
    groups: set[str] = set()
    for name in names:
        *parents, _ = name.split(".")
        groups |= {".".join(parents[: depth + 1]) for depth in range(len(parents))}
    return groups


def _converted(info: ParamInfo, value: Any, name: str) -> Any:  # noqa: ANN401 - any parameter type
    """Return a value with the type of its parameter; ConfigError if the type, range, choice or check is wrong.

    `name` is that of the parameter in messages.
    """
    value = _without_numpy(value)
    if isinstance(value, bool) and "yes" in info.choices:
        value = "yes" if value else "no"  # YAML 1.1 reads yes and no as Booleans
    try:
        value = msgspec.convert(value, info.type)
    except msgspec.ValidationError as error:
        raise ConfigError(f"'{name}' is {value!r:.40}: {_choices_in_words(info) or info.kind} is required") from error
    for item in value if isinstance(value, tuple) else (value,):
        if info.low is not None and info.high is not None and not info.low <= item <= info.high:
            limits = f"{info.low} to {info.high} {info.unit}".rstrip()
            raise ConfigError(f"'{name}' is {item}: {limits} is required")
    if info.choices and value not in info.choices:
        raise ConfigError(f"'{name}' is {value!r:.40}: {_choices_in_words(info)} is required")
    if info.check is not None:
        with naming_key(f"'{name}'"):
            info.check(value)
    return value


def _choices_in_words(info: ParamInfo) -> str:
    """Return the choices of a parameter; empty without choices. The empty text is the choice of a missing value."""
    return f"one of {', '.join(filter(None, info.choices))}" if info.choices else ""


def check_parameters(config: Any) -> None:  # noqa: ANN401 - any configuration dataclass
    """Check the values of the parameters of a configuration, without its groups; ConfigError if one is invalid.

    A configuration class that is also constructed without `build` calls this function after its construction.
    """
    for info in parameters(type(config)):
        if "." not in info.name:
            _converted(info, getattr(config, info.name), info.name)


def _without_numpy(value: Any) -> Any:  # noqa: ANN401 - any parameter type
    """Return a value with numpy scalars and arrays, even in a list or tuple, as numbers and lists of Python."""
    if isinstance(value, list | tuple):
        return [_without_numpy(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _kind_of(parameter_type: type, name: str) -> str:
    """Return the type of a parameter in words; `tuple[float, float, float]` is a list of 3 numbers.

    TypeError if the type is neither in `_KINDS` nor a tuple of one of these types.
    """
    is_list = get_origin(parameter_type) is tuple
    items = get_args(parameter_type) if is_list else (parameter_type,)
    types = {item for item in items if item is not Ellipsis}
    if len(types) != 1 or not types <= _KINDS.keys():
        known = ", ".join(kind.__name__ for kind in _KINDS)
        raise TypeError(f"the parameter {name} has the type {parameter_type}: {known}, or a tuple of one is required")
    if not is_list:
        return _KINDS[parameter_type]
    words = _ITEMS[items[0]]
    return f"a list of {words}" if Ellipsis in items else f"a list of {len(items)} {words}"


def checked(config: C) -> C:
    """Return a configuration with the checks and conversions of `build`; ConfigError for another object."""
    if not is_dataclass(config) or isinstance(config, type):
        raise ConfigError(f"config has the type {type(config).__name__}: a configuration object is required")
    return build(type(config), flatten(config), origin=type(config).__name__)


def _has_numbers(default: object) -> bool:
    """Return whether a default is or contains a number. An empty tuple counts as a tuple of numbers."""
    values = default if isinstance(default, tuple) else (default,)
    return not values or any(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)


MOST_NAMES = 12  #: Largest number of known names in a message.
MISSPELT = 0.85
"""Minimum similarity (ratio of difflib) of an unknown name to the known name that it misspells: about one letter in
seven differs. Chosen so that names of other programs are not taken for misspellings."""


def is_misspelt(name: str, known: Collection[str]) -> bool:
    """Return whether an unknown name probably misspells a known name, and is not a name of another program."""
    return bool(difflib.get_close_matches(name, known, n=1, cutoff=MISSPELT))


def suggestion(name: str, known: Collection[str]) -> str:
    """Return the known name most similar to an unknown name, or the first known names, in parentheses."""
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f" (did you mean '{close[0]}'?)"
    names = sorted(known)
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return f" (known: {', '.join(names[:MOST_NAMES])}{more})"


def _construct(config_type: type[C], values: Mapping[str, Any], prefix: str) -> C:
    """Return the dataclass of converted values by dotted name; nested dataclasses have the names with `prefix`."""
    types = get_type_hints(config_type)
    chosen: dict[str, Any] = {}
    for item in fields(config_type):  # type: ignore[arg-type]
        kind = types[item.name]
        name = prefix + item.name
        if is_dataclass(kind) and isinstance(kind, type):
            chosen[item.name] = _construct(kind, values, name + ".")
        elif name in values:
            chosen[item.name] = values[name]
    return config_type(**chosen)
