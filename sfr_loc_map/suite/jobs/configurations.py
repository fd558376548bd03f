"""The configurations of a suite: parameters of the localiser and the mapper, or methods under test in their place.

Parameters can name files: masks of the localiser, and the code of a method. The hashes of these files are part of the
key of a job, and a worker compares them with its own files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import entries_by_name
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.methods.isolation import OWN_FILES, own_files_sha256
from sfr_loc_map.methods.registry import LIBRARY_PREFIX, Method, config_text, find_method
from sfr_loc_map.suite.jobs.digests import cached
from sfr_loc_map.suite_names import OURS, Task

SECTIONS: Mapping[str, tuple[type[LocalisationConfig | MappingConfig], Task]] = {
    "localisation": (LocalisationConfig, Task.LOCALISATION),
    "mapping": (MappingConfig, Task.MAPPING),
}
METHOD, METHOD_CONFIG = "method", "method_config"
"""Keys in addition to the parameters of a section: method, and file of its configuration (in a job: its text)."""
METHOD_FILES = "method_files"  #: Name, in `Configuration.input_files`, of the files in SFR_METHOD_FILES.
MASKS = ("left_mask", "right_mask")  #: Parameters of the localiser that name masks.
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Configuration:
    """A configuration of a suite. Names begin with the section, such as `localisation.max_features`."""

    parameters: Mapping[str, object] = field(default_factory=dict)  #: Parameters that differ from their defaults.
    input_files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each mask, of the code of a method (`localisation.method`), and of the files in SFR_METHOD_FILES
    (`localisation.method_files`)."""


def read_configurations(value: object, path: Path) -> dict[str, Configuration]:
    """Return the configurations in a suite's file by their names.

    The paths of masks and of files of methods are relative to the folder of the suite's file `path`.
    """
    if value is None:
        return {"default": Configuration()}
    if not isinstance(value, Mapping) or not value:
        raise ConfigError(f"{path}: 'configurations' requires names with parameters, such as {{default: {{}}}}")
    found: dict[str, Configuration] = {}
    for name, content in entries_by_name(value, f"{path}: 'configurations'").items():
        configuration = _configuration(content, f"{path}: configuration '{name}'", path.parent)
        equal = next((other for other, of_other in found.items() if of_other == configuration), None)
        if equal is not None:
            raise ConfigError(
                f"{path}: configurations '{equal}' and '{name}' are equal (a parameter that is given with its default "
                "value makes no difference): change a parameter, or remove one of the two"
            )
        found[name] = configuration
    return found


def _configuration(content: object, origin: str, folder: Path) -> Configuration:
    if not isinstance(content, Mapping):
        raise ConfigError(
            f"{origin} is {content!r:.40}: parameters in the sections {' and '.join(SECTIONS)} are required"
        )
    parameters: dict[str, object] = {}
    input_files: dict[str, str] = {}
    for section, values in content.items():
        if section not in SECTIONS:
            raise ConfigError(f"{origin}: '{section}' is not a section: {alternatives(SECTIONS)} is required")
        if not isinstance(values, Mapping):
            raise ConfigError(f"{origin}: '{section}' is {values!r:.40}: parameters as NAME: VALUE are required")
        found = _section(values, section, origin, folder)
        parameters |= {f"{section}.{name}": value for name, value in found.parameters.items()}
        input_files |= {f"{section}.{name}": sha256 for name, sha256 in found.input_files.items()}
    return Configuration(parameters, input_files)


def _section(values: Mapping[str, object], section: str, origin: str, folder: Path) -> Configuration:
    """Return the configuration of a section, with names that do not begin with the section."""
    kind, task = SECTIONS[section]
    default = flatten(kind())
    own = {name: value for name, value in values.items() if name not in (METHOD, METHOD_CONFIG)}
    given = flatten(build(kind, own, origin=origin))
    changed = {name: value for name, value in given.items() if value != default[name]}
    if str(values.get(METHOD, OURS)) == OURS:
        unread, whose = [name for name in values if name == METHOD_CONFIG], "a method under test"
        found = _with_masks(changed, origin, folder)
    else:
        unread, whose = list(own), "the method of sfr_loc_map"
        found = _method(values, task, folder)
    if unread:
        raise ConfigError(f"{origin}: '{unread[0]}' is a parameter of {whose} and would be ignored: omit it")
    return found


def _with_masks(parameters: Mapping[str, object], origin: str, folder: Path) -> Configuration:
    """Return parameters of ours with the absolute paths of their masks."""
    masks: dict[str, Path] = {}
    for name in MASKS:
        if name in parameters:
            masks[name] = (folder / str(parameters[name])).resolve()
    for name, path in masks.items():
        if not path.is_file():
            raise ConfigError(f"{origin}: {name} is '{path}', which is not a file: give a PNG mask")
    paths = {name: str(path) for name, path in masks.items()}
    return Configuration({**parameters, **paths}, {name: cached(path, hash_path) for name, path in masks.items()})


def _method(values: Mapping[str, object], task: Task, folder: Path) -> Configuration:
    """Return the absolute path of a method and the text of its configuration, with the hashes of its files."""
    spec = str(values[METHOD])
    module, _, name = spec.rpartition(":")
    if spec.startswith(LIBRARY_PREFIX):
        spec = f"{LIBRARY_PREFIX}{(folder / spec.removeprefix(LIBRARY_PREFIX)).resolve()}"
    elif module.endswith(".py"):
        spec = f"{(folder / module).resolve()}:{name}"
    text = config_text(folder / str(values[METHOD_CONFIG]) if METHOD_CONFIG in values else None)
    return Configuration({METHOD: spec, METHOD_CONFIG: text}, _files_of_method(find_method(spec, task, text)))


def _files_of_method(method: Method) -> dict[str, str]:
    """Return the hashes of a method's own code and of the files in SFR_METHOD_FILES; empty for a built-in method."""
    files = own_files_sha256() if method.reads_own_files else None
    found = {METHOD: method.sha256, METHOD_FILES: files}
    return {name: sha256 for name, sha256 in found.items() if sha256}


def chosen_method(parameters: Mapping[str, object], task: Task) -> Method | None:
    """Return the method in the parameters of a section, None for ours; MethodError if the method is missing."""
    if METHOD not in parameters:
        return None
    return find_method(str(parameters[METHOD]), task, str(parameters.get(METHOD_CONFIG, "")))


def check_input_files(configuration: Configuration) -> None:
    """Raise InputError if a file of a configuration is not that for which the job was planned.

    MethodError if a method is missing.
    """
    for section, (_, task) in SECTIONS.items():
        found = in_section(configuration, section)
        for name in MASKS:
            path = found.parameters.get(name)
            if path is not None and cached(Path(str(path)), hash_path) != found.input_files.get(name):
                raise _changed(f"the {name} '{path}'")
        method = chosen_method(found.parameters, task)
        if method is None:
            continue
        files = _files_of_method(method)
        for name, what in ((METHOD, "code"), (METHOD_FILES, f"files ({OWN_FILES})")):
            if files.get(name) != found.input_files.get(name):
                raise _changed(f"the {what} of the method '{method.name}'")


def in_section(configuration: Configuration, section: str) -> Configuration:
    """Return the part of a configuration that is in a section, with names that do not begin with the section."""
    return Configuration(
        values_in_section(configuration.parameters, section), values_in_section(configuration.input_files, section)
    )


def values_in_section(values: Mapping[str, T], section: str) -> dict[str, T]:
    """Return the values of a section, by their names within the section."""
    prefix = f"{section}."
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def _changed(what: str) -> InputError:
    return InputError(f"{what} differs from that of the plan: repeat the command, with equal files on all hosts")
