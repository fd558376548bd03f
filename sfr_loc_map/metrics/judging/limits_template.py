"""The commented limits file that `sfr init` writes."""

from __future__ import annotations

import hashlib

from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.score.limits import COUNT_FOR_VERDICT, INDEPENDENT_FOR_VERDICT, LIMITED_NUMBERS

LIMITS_HEAD = """\
# Limits: PLACEHOLDERS, replace them by the limits of your own document. Limits are upper bounds, except coverage_min.
# The name of a limit ends in its unit. A line that begins with '#' is not active. Option --limits of sfr score and sfr
# replay reads this file. The exit code is 1 if a limit is missed, and 3 if a limit cannot be judged.

# Minimum number of values for a verdict (2 or more).
minimum_count: {minimum_count}
# Minimum number of independent sub-trajectories for a verdict. A drive of 30 m has five of 5 m.
minimum_independent: {minimum_independent}
# Hashes of the agreed data set, as sfr info SRC shows them. Any other data set is refused.
# data_set_sha256: [HASH, HASH]

# Errors at the end of sub-trajectories: one entry for each condition.
trajectory:
  # distance=METRES, time=SECONDS, frames=NUMBER, displacement=METRES, turn=DEGREES, or several: distance=5,time=10
  - condition: {condition}
    # id: LOC-12
    # text: 3D position error over 5 m
    # certain: true    (a pass requires the complete 95 % interval to be within the limit)"""
CONDITION = "distance=5"
POSES = "position_mean_plus_3sigma_m", "attitude_mean_plus_3sigma_deg", "heading_mean_plus_3sigma_deg"
POSITIONS = "position_mean_plus_3sigma_m", "chord_mean_plus_3sigma_m"  #: Limits for a truth with only positions.
HORIZONTAL = ("horizontal_mean_plus_3sigma_m",)  #: Limits for a truth with only positions and without heights.
HASH_OF_LINES = "# sfr init --overwrite keeps this file if it was edited. SHA-256 of the lines above: "
LIMITS_MEANINGS = {
    "completeness": "Fractions of the estimate or the cloud that are missing or cannot be judged",
    "map": "Errors of a map; in a score without a map these limits have not enough data",
    "timing": "Time of a call on this host, which does not apply to a flight computer",
    "memory": "Resident memory of the process during a call, on this host",
    "target": "Calls that were measured on the target (--target, --target-timing)",
}


def active_limits(*, has_attitude: bool, has_height: bool, has_tilt: bool) -> tuple[str, ...]:
    """Return the limits that can be judged by a ground truth with these components."""
    if not has_attitude:
        return POSITIONS if has_height else HORIZONTAL
    position, attitude, heading = POSES
    return (position if has_height else HORIZONTAL[0], *((attitude,) if has_tilt else ()), heading)


def limits_text(condition: str = CONDITION, active: tuple[str, ...] = POSES) -> str:
    """Return the text of a limits file, in which all limits but those named in `active` are commented out.

    The last line contains the hash of the other lines.
    """
    head = LIMITS_HEAD.replace("{minimum_count}", f"{COUNT_FOR_VERDICT}")
    head = head.replace("{minimum_independent}", f"{INDEPENDENT_FOR_VERDICT:g}")
    lines = [head.replace("{condition}", condition)]
    for name in LIMITED_NUMBERS[LimitSection.TRAJECTORY]:
        lines.append(f"    {'' if name in active else '# '}{name}: {0.1 if name.endswith('_m') else 1.0}")
    for part, meaning in LIMITS_MEANINGS.items():
        lines += ["", f"# {meaning}.", f"# {part}:"]
        lines += [
            f"#   {name}: {1.0e9 if name.endswith('_bytes') else 0.5}" for name in LIMITED_NUMBERS[LimitSection(part)]
        ]
    content = "\n".join(lines) + "\n\n"
    return content + _hash_line(content)


def is_edited(text: str) -> bool:
    """Return whether the text of a limits file differs from every text that `limits_text` returned.

    A text without a hash in its last line is edited.
    """
    content, _, _ = text.rpartition(HASH_OF_LINES)
    return text != content + _hash_line(content)


def _hash_line(content: str) -> str:
    """Return the last line of a limits file, by which changes of the other lines are detected."""
    return f"{HASH_OF_LINES}{hashlib.sha256(content.encode()).hexdigest()}\n"
