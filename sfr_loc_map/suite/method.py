"""The method of a configuration: what the file says of it, and what a task needs to start it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import read_text
from sfr_loc_map.methods.method import OURS, Method, MethodTask
from sfr_loc_map.methods.registry import LIBRARY_PREFIX, find_method

METHOD_KEYS = ("method", "method_config", "method_sha256")
"""Keys beside the parameters of a part: the method, the file with its configuration; the last is added here."""


def suite_method(values: Mapping[str, object], task: MethodTask, folder: Path) -> dict[str, object]:
    """Return what a task keeps of a method: whole paths, the text of its configuration, the hash of its file.

    Args:
        values: Keys of the part; `method_config` is a path relative to the suite's file.
        task: What it does.
        folder: Folder of the suite's file.

    Raises:
        MethodError: If there is no such method.
        ConfigError: If its configuration cannot be read.
    """
    spec = _whole(str(values["method"]), folder)
    text = ""
    if "method_config" in values:
        path = folder / str(values["method_config"])
        try:
            text = read_text(path)
        except (OSError, ValueError) as error:
            raise ConfigError(f"'method_config: {path}' cannot be read ({error}): give a text file") from error
    if spec == OURS:
        return {}
    found = find_method(spec, task, text)
    return dict(zip(METHOD_KEYS, (spec, text, found.sha256 or ""), strict=True))


def task_method(section: Mapping[str, object], task: MethodTask) -> Method | None:
    """Return the method of a task's part, None where it is ours.

    Raises:
        MethodError: If there is no such method any more.
    """
    if "method" not in section:
        return None
    return find_method(str(section["method"]), task, str(section.get("method_config", "")))


def _whole(spec: str, folder: Path) -> str:
    """Return a method's text with a whole path."""
    if spec.startswith(LIBRARY_PREFIX):
        return f"{LIBRARY_PREFIX}{(folder / spec.removeprefix(LIBRARY_PREFIX)).resolve()}"
    place, _, name = spec.rpartition(":")
    return f"{(folder / place).resolve()}:{name}" if place.endswith(".py") else spec
