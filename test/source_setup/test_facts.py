"""The facts of a source: each topic of a bag with the name under which it is read."""

from __future__ import annotations

from pathlib import Path

from helpers.made_worlds import make_world, write_bag
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.source_setup.facts import facts_of


def test_a_topic_that_is_read_under_its_own_name_is_listed_as_read(tmp_path: Path) -> None:
    facts = facts_of(write_bag(tmp_path / "x.mcap", make_world()), SourceConfig())
    read_as = {topic["name"]: topic["read as"] for topic in facts.topics}
    assert read_as["/loc/left/image_rect"] == "loc/left/image_rect"


def test_a_wrong_remapping_is_a_fact_beside_the_topics(tmp_path: Path) -> None:
    facts = facts_of(
        write_bag(tmp_path / "x.mcap", make_world()), SourceConfig(topics={"loc/left/image_rect": "/nowhere"})
    )
    assert "no topic 'nowhere'" in facts.problem
    assert "/loc/left/image_rect" in [topic["name"] for topic in facts.topics]


def test_a_bag_that_cannot_be_opened_has_its_error_as_a_fact(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n")
    facts = facts_of(tmp_path / "x.mcap", SourceConfig())
    assert "x.mcap" in facts.problem
    assert not facts.topics
