"""The content of calibration files (named values in YAML, JSON or XML), and the second file of a calibration."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sfr_loc_map.inputs import read_text
from sfr_loc_map.json_yaml import parse_yaml
from sfr_loc_map.message_text import alternatives

PARTNERS = (("left", "right"), ("cam0", "cam1"), ("intrinsics", "extrinsics"), ("cameras.txt", "rig_config.json"))
"""Words in which the names of the two files of a calibration, or of their folders, differ."""
WIDTHS, HEIGHTS = ("image_width", "width"), ("image_height", "height")  #: Names of the image width and height.
COLMAP_FILE = "cameras.txt"
"""Name of COLMAP's file with the intrinsics. Its other file has the poses of the cameras in the rig."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenedFile:
    """A calibration file with its content, and the second file of the calibration."""

    file: Path
    other: Path | None  #: The second file, found by its name; None if there is none.
    content: Any  #: Parsed YAML, JSON or XML; keys of a mapping are plain names (`plain_name`).
    shown_names: list[str]  #: The names in the content as written, in alphabetical order.
    size: tuple[int, int] | None  #: Width and height of the images, if known.

    @property
    def files(self) -> list[Path]:
        """The one or two files of the calibration, in the order of their names."""
        return sorted([self.file.absolute(), *([self.other] if self.other else [])])


def open_calibration(file: Path, size: tuple[int, int] | None) -> OpenedFile:
    """Open a calibration file; COLMAP's list of cameras is neither YAML nor JSON, and is read later."""
    content = None if is_colmap_list(file) else content_of(file)
    names = sorted(str(name) for name in content) if isinstance(content, dict) else []
    plain = _with_plain_names(content) if isinstance(content, dict) else content
    return OpenedFile(file, partner_of(file), plain, names, size)


def plain_name(name: str) -> str:
    """Return a name in lower case without underscores, because programs and their versions differ in both."""
    return name.lower().replace("_", "")


def _with_plain_names(content: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the values by their plain names; raise ValueError if a plain name gets two values."""
    found: dict[str, Any] = {}
    for name, value in content.items():
        plain = plain_name(str(name))
        if plain in found and not are_equal(found[plain], value):
            raise ValueError(f"it has two values of {name}, whose names differ only in case or underscores")
        found[plain] = value
    return found


def is_colmap_list(file: Path) -> bool:
    """Return whether a file has the name of COLMAP's list of cameras, in upper or lower case."""
    return file.name.lower().endswith(COLMAP_FILE)


def partner_of(file: Path) -> Path | None:
    """Return the second file of the calibration to which a file belongs; None if there is no second file."""
    file, candidates = file.absolute(), []
    for one, other in (*PARTNERS, *(pair[::-1] for pair in PARTNERS)):
        candidates.append(file.with_name(_with_word(file.name, one, other)))
        candidates.append(file.parent.with_name(_with_word(file.parent.name, one, other)) / file.name)
    return next((path for path in candidates if path != file and path.is_file()), None)


def _with_word(name: str, old: str, new: str) -> str:
    """Return a name with `old` replaced by `new`, in the case of `old`: `Left.yaml` becomes `Right.yaml`."""

    def in_its_case(found: re.Match[str]) -> str:
        if found[0].isupper():
            return new.upper()
        return new.capitalize() if found[0][0].isupper() else new

    return re.sub(re.escape(old), in_its_case, name, flags=re.IGNORECASE)


def content_of(file: Path) -> Any:  # noqa: ANN401 - any YAML or JSON
    """Return the content of YAML, JSON (which is YAML, except for tabs) or OpenCV's XML."""
    text = read_text(file).strip()
    if text.startswith("[LEFT_CAM"):
        raise ValueError(
            "it is a factory calibration of a ZED camera, which is not supported: write M1 D1 M2 D2 R T of OpenCV with "
            "the ZED SDK, or use rectified images with their camera_info"
        )
    if text.startswith("<"):
        if "<!" in text.replace("<!--", ""):
            raise ValueError("XML with a DOCTYPE, an ENTITY or a CDATA section is not supported: remove it")
        try:
            root = ET.fromstring(text)
        except ET.ParseError as error:
            raise ValueError(f"it is not complete XML: {error}") from error
        return {name: _xml_value(item) for name, item in _elements_in(root).items()}
    try:
        return _one_of_equal([parse_opencv_yaml(part) for part in _documents(text)])
    except yaml.YAMLError as error:
        raise ValueError(f"it is not YAML, JSON or XML: {error}") from error


def _documents(text: str) -> list[str]:
    """Return the documents of a YAML text; `ros2 topic echo` writes one for each message, ended by `---`."""
    parts = re.split(r"^---[ \t]*$", text, flags=re.MULTILINE)
    filled = [part for part in parts if re.sub(r"^[%#].*$", "", part, flags=re.MULTILINE).strip()]
    return filled or [text.removesuffix("---")]


def _one_of_equal(documents: Sequence[Any]) -> Any:  # noqa: ANN401 - any YAML
    """Return the first of several documents; raise ValueError if they differ in more than their headers."""
    first, *others = (
        {name: value for name, value in each.items() if name != "header"} if isinstance(each, dict) else each
        for each in documents
    )
    if any(other != first for other in others):
        raise ValueError(
            f"it has {len(documents)} different YAML documents, separated by '---': one document is required; write "
            "each camera to a file of its own, left.yaml and right.yaml"
        )
    return documents[0]


def _xml_value(element: ET.Element) -> dict[str, str | None] | str | None:
    """Return the texts of the elements in an element by their names, or its text if it contains no element."""
    parts = _elements_in(element)
    return {name: part.text for name, part in parts.items()} if parts else element.text


def _elements_in(parent: ET.Element) -> dict[str, ET.Element]:
    """Return the elements in an element by their names; raise ValueError if a name occurs twice.

    Only `_` may occur several times, because OpenCV gives this name to each item of a list.
    """
    elements: dict[str, ET.Element] = {}
    for element in parent:
        if element.tag in elements and element.tag != "_":
            raise ValueError(f"it has '{element.tag[:40]}' twice: give it once")
        elements[element.tag] = element
    return elements


def named_values(file: Path) -> dict[str, Any]:
    """Return the values in a file by their plain names (`plain_name`); raise ValueError unless it is a mapping."""
    content = content_of(file)
    if not isinstance(content, dict):
        raise ValueError("the file has no mapping of names to values")
    return _with_plain_names(content)


def parse_opencv_yaml(text: str) -> Any:  # noqa: ANN401 - any YAML
    """Return the value of a YAML text as cv::FileStorage reads it: `%YAML:1.0`, `data:[`, tags and tabs."""
    text = re.sub(r"^%.*$|!!opencv-\S+|\t", " ", text, flags=re.MULTILINE)
    return parse_yaml(re.sub(r"^(\s*[A-Za-z][\w.]*):(?=[\[\d.+-])", r"\1: ", text, flags=re.MULTILINE))


def numbers_of(content: Mapping[str, Any], *names: str) -> tuple[float, ...]:
    """Return the numbers, row by row, of the matrix that has one of `names` in the content.

    Raises ValueError if the matrix is missing or invalid, or if matrices of several names differ.
    """
    matrices = {name: _numbers_in(content[plain_name(name)], name) for name in names if plain_name(name) in content}
    if not matrices:
        raise ValueError(f"it has no {alternatives(names)}")
    if len(set(matrices.values())) > 1:
        raise ValueError(f"{' and '.join(matrices)} differ: give one of them")
    return next(iter(matrices.values()))


def _numbers_in(item: Any, name: str) -> tuple[float, ...]:  # noqa: ANN401 - any YAML
    """Return the numbers, row by row, of a matrix; raise ValueError, which contains its name, if it is invalid."""
    if isinstance(item, dict) and "data" not in item:
        raise ValueError(f"{name} has no data")
    value = item["data"] if isinstance(item, dict) else item
    try:
        numbers = np.array(value.split() if isinstance(value, str) else value, np.float64).reshape(-1)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is {value!r:.60}: numbers are required") from error
    if isinstance(item, dict) and {"rows", "cols"} <= item.keys():
        rows, columns = (number_of(item, count) for count in ("rows", "cols"))
        if rows * columns != len(numbers):
            raise ValueError(f"{name} has {len(numbers)} numbers for {rows:g} rows and {columns:g} columns")
    return tuple(numbers.tolist())


def are_equal(one: Any, other: Any) -> bool:  # noqa: ANN401 - any YAML or XML
    """Return whether two values of files are equal. XML has numbers as texts, which may be written in several ways."""
    try:
        return _numbers_in(one, "") == _numbers_in(other, "")
    except ValueError:  # a value has no numbers
        return str(one).lower() == str(other).lower()


def number_of(content: Mapping[str, Any], name: str) -> float:
    """Return the number with a name; raise ValueError if there is none."""
    if plain_name(name) not in content:
        raise ValueError(f"it has no {name}")
    value = content[plain_name(name)]
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} is {value!r:.60}: a number is required") from error


def size_of(content: Mapping[str, Any], given: tuple[int, int] | None = None) -> tuple[int, int]:
    """Return the width and height of the images, in the file or as `given`; raise ValueError if unknown."""
    found = stated_size(content) or given
    if found is None:
        raise ValueError("the image size is missing: image_size, or image_width and image_height, are required")
    return found


def stated_size(content: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the width and height in the content; None unless it has both. Raises ValueError unless both are whole."""
    if "imagesize" in content:
        return whole_size(*numbers_of(content, "image_size")[:2])
    has_both = all(any(plain_name(name) in content for name in names) for names in (WIDTHS, HEIGHTS))
    return whole_size(*numbers_of(content, *WIDTHS), *numbers_of(content, *HEIGHTS)) if has_both else None


def whole_size(*size: float) -> tuple[int, int]:
    """Return a width and a height as integers; raise ValueError unless both are whole numbers."""
    if len(size) != 2 or not all(number.is_integer() for number in size):
        shown = " x ".join(f"{number:g}" for number in size)
        raise ValueError(f"the image size is {shown}: two whole numbers of pixels are required")
    width, height = size
    return int(width), int(height)
