"""A client of the Foxglove protocol reads every channel, and what it reads is what `state.json` says."""

from __future__ import annotations

import asyncio
import json
import re
import struct
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="needs the extra [foxglove]")
pytest.importorskip("aiohttp", reason="needs the extra [live]")

import aiohttp

from helpers.foxglove_client import first_messages
from helpers.live_run import updates
from helpers.page_server import served
from helpers.score_rows import number
from sfr_loc_map.errors import NodeError
from sfr_loc_map.live.foxglove import IMAGES, TOPICS, FoxgloveServer
from sfr_loc_map.live.media import cloud_samples, image_sample
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import MediaKind

BEGIN_S = 1_700_000_000.0  # so long ago that all is stale, whenever it is asked for
COUNT = 120
STAMP_NS = 5_000_000_007
MOMENTARY = {"time_s", "age_s", "report_age_s", "server"}
"""Ages: of the moment in which they are asked for."""


def without_ages(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_ages(item) for key, item in value.items() if key not in MOMENTARY}
    if isinstance(value, str):  # as in the reasons why a verdict is stale
        return re.sub(r"\d+\.\d s\b", "AGE s", value)
    return [without_ages(item) for item in value] if isinstance(value, list) else value


@pytest.fixture(scope="module")
def shown() -> tuple[dict[str, Any], dict[str, Any], dict[str, Any], Any]:
    """Channels and messages of a Foxglove client, `state.json` of the page beside it, what was fed."""
    points = np.random.default_rng(1).uniform((0, 0, -1), (3, 2, 1), (500, 3)).astype(np.float32)
    cloud, grid = cloud_samples(STAMP_NS, points, np.full(500, 0.02), BEGIN_S, np.full(500, 0.5))
    pixels = np.full((48, 64), 90, np.uint8)
    images = [image_sample(topic.removeprefix("/"), STAMP_NS, pixels, BEGIN_S) for topic in IMAGES]

    async def run() -> tuple[Any, ...]:
        state = LiveState()
        for update in (*updates(COUNT, BEGIN_S), cloud, grid, *images):
            state.put(update)
        async with served(state) as server:
            with FoxgloveServer(state, 0, "rover1") as view:
                assert view.url.startswith("ws://127.0.0.1:")
                with pytest.raises(NodeError, match="--foxglove-port"):
                    FoxgloveServer(state, int(view.url.rpartition(":")[2]), "another").__enter__()
                wanted: list[frozenset[MediaKind]] = []
                channels, messages = await first_messages(view.url, lambda: wanted.append(state.displayed.wanted))
                assert wanted == [{MediaKind.IMAGES, MediaKind.CLOUDS, MediaKind.MAPS}], "what is looked at is made"
                async with aiohttp.ClientSession() as session, session.get(server.url + "state.json") as answer:
                    told = await answer.json()
                while state.displayed.wanted:  # nothing is made once the client is gone
                    await asyncio.sleep(0.02)
        return channels, messages, told, (cloud, images, state.path.rows)

    return asyncio.run(asyncio.wait_for(run(), 100))  # type: ignore[return-value]


def test_every_channel_is_read_with_a_fitting_schema_and_figures_are_those_of_state_json(shown: Any) -> None:
    channels, messages, state, _ = shown
    assert set(channels) == set(messages) == set(TOPICS)
    names = {topic: channel["schemaName"].removeprefix("foxglove.") for topic, channel in channels.items()}
    kinds = ("Grid", "PointCloud", "PosesInFrame", "PosesInFrame", *["CompressedImage"] * 4)
    topics = ("/mapping/grid", "/mapping/points", "/path/estimate", "/path/truth", *IMAGES)
    assert dict(zip(topics, kinds, strict=True)).items() <= names.items()
    figures = json.loads(messages["/figures"])
    assert without_ages(figures) == without_ages(state)
    assert number(figures, "position", "mean_plus_3sigma") > 0.0


def test_messages_hold_the_values_that_were_fed(shown: Any) -> None:
    """Protobuf keeps doubles, texts and bytes as they are, so each is found without a decoder."""
    _, messages, state, (cloud, images, rows) = shown
    for name, positions in (("estimate", [row.position_m for row in rows]), ("truth", [row.truth_m for row in rows])):
        for value in {float(value) for position in positions for value in position} - {0.0}:
            assert struct.pack("<d", value) in messages[f"/path/{name}"]
    assert rows[-1].position_m == pytest.approx(state["live"]["localisation"]["position_m"], abs=1e-5)
    points, grid = messages["/mapping/points"], messages["/mapping/grid"]
    assert np.column_stack((cloud.points, cloud.error)).astype("<f4").tobytes() in points
    assert all(name.encode() in points for name in ("x", "y", "z", "sigma", "error"))
    assert all(name.encode() in grid for name in ("height", "sigma", "count"))
    assert struct.pack("<f", 0.02) in grid
    for image in images:
        assert image.jpeg in messages[f"/{image.topic}"]
