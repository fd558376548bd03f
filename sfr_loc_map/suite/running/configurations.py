"""The configurations of a suite: parameters of the localiser and the mapper, or methods under test in their place.

A configuration has the hashes of the files that its parameters name, so that they are part of the key of a job. A
worker compares them with its own files.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import entries_by_name
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import read_text, refusing
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.methods.isolation import OWN_FILES, own_files_sha256
from sfr_loc_map.methods.registry import LIBRARY_PREFIX, Method, find_method
from sfr_loc_map.suite.running.digests import cached
from sfr_loc_map.suite_names import OURS, Task

SECTIONS: Mapping[str, tuple[type[LocalisationConfig | MappingConfig], Task]] = {
    "localisation": (LocalisationConfig, Task.LOCALISATION),
    "mapping": (MappingConfig, Task.MAPPING),
}
METHOD, METHOD_CONFIG = "method", "method_config"
METHOD_SHA256, METHOD_FILES_SHA256 = "method_sha256", "method_files_sha256"
METHOD_KEYS = (METHOD, METHOD_CONFIG, METHOD_SHA256, METHOD_FILES_SHA256)
"""Keys in addition to the parameters of a section: method and file of its configuration. Added here: the hashes of its
own code and of the files in SFR_METHOD_FILES; empty if there are none."""
MASK_HASHES = {"left_mask": "left_mask_sha256", "right_mask": "right_mask_sha256"}
"""Key of the hash (added here) of each parameter that names a mask of the localiser."""


def read_configurations(value: object, path: Path) -> dict[str, dict[str, object]]:
    """Return, for each configuration in a suite's file, the parameters that differ from their defaults.

    `path` is the file of the suite, to whose folder the files of methods and the masks are relative.
    """
    if value is None:
        return {"default": {}}
    if not isinstance(value, Mapping) or not value:
        raise ConfigError(f"{path}: 'configurations' requires names with parameters, such as {{default: {{}}}}")
    found: dict[str, dict[str, object]] = {}
    for name, content in entries_by_name(value, f"{path}: 'configurations'").items():
        parameters = _parameters(content, f"{path}: configuration '{name}'", path.parent)
        equal = next((other for other, of_other in found.items() if of_other == parameters), None)
        if equal is not None:
            raise ConfigError(
                f"{path}: configurations '{equal}' and '{name}' are equal (a parameter that is given with its default "
                "value makes no difference): change a parameter, or remove one of the two"
            )
        found[name] = parameters
    return found


def _parameters(content: object, origin: str, folder: Path) -> dict[str, object]:
    if not isinstance(content, Mapping):
        raise ConfigError(
            f"{origin} is {content!r:.40}: parameters in the sections {' and '.join(SECTIONS)} are required"
        )
    changed: dict[str, object] = {}
    for section, values in content.items():
        if section not in SECTIONS:
            raise ConfigError(f"{origin}: '{section}' is not a section: {alternatives(SECTIONS)} is required")
        if not isinstance(values, Mapping):
            raise ConfigError(f"{origin}: '{section}' is {values!r:.40}: parameters as NAME: VALUE are required")
        kind, task = SECTIONS[section]
        default = flatten(kind())
        own = {name: value for name, value in values.items() if name not in (METHOD, METHOD_CONFIG)}
        given = flatten(build(kind, own, origin=origin))
        new = {name: value for name, value in given.items() if value != default[name]}
        for name in MASK_HASHES.keys() & new.keys():
            new |= _mask(name, folder / str(new[name]), origin)
        if METHOD in values:
            new |= _method(values, task, folder)
        is_ours = str(values.get(METHOD, OURS)) == OURS
        if is_ours:
            unread, whose = [name for name in values if name == METHOD_CONFIG], "a method under test"
        else:
            unread, whose = list(own), "the method of sfr_loc_map"
        if unread:
            raise ConfigError(f"{origin}: '{unread[0]}' is a parameter of {whose} and would be ignored: omit it")
        changed |= {f"{section}.{name}": value for name, value in new.items()}
    return changed


def _mask(name: str, path: Path, origin: str) -> dict[str, object]:
    """Return the absolute path of a mask, and the hash of its file."""
    place = path.resolve()
    if not place.is_file():
        raise ConfigError(f"{origin}: {name} is '{place}', which is not a file: give a PNG mask")
    return {name: str(place), MASK_HASHES[name]: cached(place, hash_path)}


def _method(values: Mapping[str, object], task: Task, folder: Path) -> dict[str, object]:
    """Return the fields of a method for a job: absolute path, text of the configuration, and hash of the own code."""
    spec, text = str(values[METHOD]), ""
    place, _, name = spec.rpartition(":")
    if spec.startswith(LIBRARY_PREFIX):
        spec = f"{LIBRARY_PREFIX}{(folder / spec.removeprefix(LIBRARY_PREFIX)).resolve()}"
    elif place.endswith(".py"):
        spec = f"{(folder / place).resolve()}:{name}"
    if METHOD_CONFIG in values:
        path = folder / str(values[METHOD_CONFIG])
        with refusing(f"cannot read '{path}'", "give the text file with the configuration of the method"):
            text = read_text(path)
    if spec == OURS:
        return {}
    method = find_method(spec, task, text)
    return dict(zip(METHOD_KEYS, (spec, text, *_hashes_of(method)), strict=True))


def _hashes_of(method: Method) -> tuple[str, str]:
    """Return the hashes of a method's own code and of the files in SFR_METHOD_FILES; empty for a built-in method."""
    files = own_files_sha256() if method.reads_own_files else None
    return method.sha256 or "", files or ""


def chosen_method(section: Mapping[str, object], task: Task) -> Method | None:
    """Return the method in a section of a configuration, None for ours; MethodError if the method is missing.

    InputError if its code or its files are not those for which the job was planned.
    """
    if METHOD not in section:
        return None
    method = find_method(str(section[METHOD]), task, str(section.get(METHOD_CONFIG, "")))
    planned = (section.get(METHOD_SHA256, ""), section.get(METHOD_FILES_SHA256, ""))
    for planned_sha256, sha256, what in zip(planned, _hashes_of(method), ("code", f"files ({OWN_FILES})"), strict=True):
        if sha256 != planned_sha256:
            raise _changed(f"the {what} of the method '{method.name}'")
    return method


def check_masks(section: Mapping[str, object]) -> None:
    """Raise InputError if a mask in a section is not the file for which the job was planned."""
    for name, hash_name in MASK_HASHES.items():
        if name in section and cached(Path(str(section[name])), hash_path) != section.get(hash_name):
            raise _changed(f"the {name} '{section[name]}'")


def _changed(what: str) -> InputError:
    return InputError(f"{what} differs from that of the plan: repeat the command, with equal files on all hosts")
