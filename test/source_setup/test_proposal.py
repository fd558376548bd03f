"""The proposed configuration of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from helpers.message_bags import write_messages
from sfr_loc_map.io.bag import messages
from sfr_loc_map.source_setup.proposal import propose_config


def test_a_recording_without_images_has_a_proposal(tmp_path: Path) -> None:
    """No topic is searched for the missing images, whatever the names of the topics are."""
    message = messages.odometry(1, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    place = write_messages(tmp_path / "x", [("/loc/left/None", 1, message)])
    assert propose_config(place, {}).missing
