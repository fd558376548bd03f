"""One thing, one word: the words of the field's papers, of ROS and of OpenCV. CONTRIBUTING.md has the rule."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("sfr_loc_map", "test", "docs", "config", "launch_scripts", "docker", "scripts")
SUFFIXES = {".py", ".pyi", ".md", ".yaml", ".xml", ".html", ".toml", ".cfg", ".sh", ""}
BANNED = {
    "picture": "image",
    "cure": "fix",
    "mend": "fix",
    "mended": "fixed",
    "mends": "fixes",
    "anew": "again",
    "spoil": "corrupt",
    "spoils": "corrupts",
    "spoiled": "corrupted",
    "surer": "with the lower variance",
    "way-points": "waypoints",
    "would stop us": "blocking issue",
    "found back": "recovered",
    "laid on": "aligned with",
    "lied to": "fed malformed data",
    "to the bit": "bit-identical",
    "over the wheels": "with the pip wheels",
    "mistake of convention": "convention mismatch",
    "worse than thought": "noise above the model",
    "with precedence": "with real-time priority",
    "the clock stands": "the clock stops",
    "on purpose": "injected",
    "shaking": "vibration",
    "last words": "last log line",
    "pose known last": "last known pose",
    "some times a second": "at a few hertz",
    "the way driven": "path travelled",
    "twice the evidence": "a stricter threshold",
    "nothing to go on": "not used as a reference",
    "machine code": "compiled code",
}
"""What is not said, and what is said instead."""
PUBLIC = re.compile(r"[\"`](cure|picture_size)[\"`]")
"""Names that programs read: JSON keys and codes of `sfr doctor`."""
PATTERN = re.compile(
    r"(?<![a-zA-Z])(" + "|".join(re.escape(w).replace(r"\ ", r"\s+") for w in [*BANNED, "pictures"]) + r")(?![a-zA-Z])",
    re.IGNORECASE,
)


def texts() -> list[Path]:
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.is_file()]
    files += [path for path in ROOT.iterdir() if path.is_file()]
    kept = [path for path in files if path.suffix in SUFFIXES and "__pycache__" not in path.parts]
    return sorted(path for path in kept if path not in (Path(__file__).resolve(), ROOT / "LICENSE"))


def banned_in(text: str) -> list[str]:
    """Return the lines with a banned word; in names, words are parted by underscores and capitals."""
    found = []
    lines = text.splitlines()
    for match in PATTERN.finditer(re.sub(r"(?<=[a-z])(?=[A-Z])", "\0", PUBLIC.sub(lambda m: "_" * len(m[0]), text))):
        number = text.count("\n", 0, match.start())
        found.append(f"line {number + 1}: {match.group()}: {lines[min(number, len(lines) - 1)].strip()[:80]}")
    return found


def test_words_are_those_of_the_field() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {line}"
        for path in texts()
        if b"\0" not in (data := path.read_bytes())
        for line in banned_in(data.decode("utf-8", "replace"))
    ]
    assert not found


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("the picture is", 1),
        ("check_picture(x)", 1),
        ("class PicturePair", 1),
        ("two pictures", 1),
        ("what would\n    stop us", 1),
        ("secure and amend a procedure", 0),
        ("the image", 0),
        ('{"cure": fix}', 0),
    ],
)
def test_banned_words_are_found(text: str, count: int) -> None:
    assert len(banned_in(text)) == count
