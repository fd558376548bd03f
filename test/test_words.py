"""One thing, one word: the words of the field's papers, of ROS and of OpenCV. CONTRIBUTING.md has the rule."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("sfr_loc_map", "test", "docs", "config", "launch_scripts", "docker", "scripts")
SUFFIXES = {".py", ".pyi", ".md", ".yaml", ".xml", ".html", ".toml", ".cfg", ".sh", ""}
BANNED = """
picture, pictures: image
cure, mend, mends, mended: fix
anew: again
spoil, spoils, spoiled: corrupt
surer: with the lower variance
way-points: waypoints
found back: recovered
would stop us: blocking issue
laid on: aligned with
lied to: fed malformed data
to the bit: bit-identical
over the wheels: with the pip wheels
mistake of convention: convention mismatch
worse than thought: noise above the model
with precedence: with real-time priority
the clock stands: the clock stops
on purpose: injected
shaking: vibration
last words: last log line
pose known last: last known pose
some times a second: at a few hertz
the way driven: path travelled
twice the evidence: a stricter threshold
nothing to go on: not used as a reference
machine code: compiled code
"""
"""What is not said, and what is said instead."""
PUBLIC = re.compile(r"[\"`\[#](cure|picture_size)\b")
"""Names that programs read: JSON keys and codes of `sfr doctor`."""
WORDS = [word for line in BANNED.split("\n") for word in line.partition(":")[0].split(", ") if word]
PATTERN = re.compile("(?<![a-z])(" + "|".join(WORDS).replace(" ", r"\s+") + ")(?![a-z])", re.IGNORECASE)


def banned_in(text: str) -> list[str]:
    """Return the lines with a banned word; in names, words are parted by underscores and capitals."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", "\0", PUBLIC.sub("_", text))
    return [f"line {parted[: found.start()].count(chr(10)) + 1}: {found[0]}" for found in PATTERN.finditer(parted)]


def test_words_are_those_of_the_field() -> None:
    assert len(banned_in('the picture; check_picture(x); PicturePair; would\n  stop us; secure; {"cure": fix}')) == 4
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*")] + list(ROOT.iterdir())
    for path in files:
        if path.is_file() and path.suffix in SUFFIXES and path not in (Path(__file__).resolve(), ROOT / "LICENSE"):
            data = path.read_bytes()
            assert b"\0" in data or not banned_in(data.decode("utf-8", "replace")), path
