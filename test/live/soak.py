"""Load tests of the live page that no test suite has time for: `make live-soak`.

python test/live/soak.py clients [MINUTES]
    three pages and one that never reads, beside a replay of the sample at 10 Hz in a loop; in six rounds, each begins
    with a minute without pages
python test/live/soak.py load [SECONDS]
    stereo images of 1 MP and poses at 10 Hz and a cloud of a million points each 5 s
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import psutil
from on_screen import LIVE, SAMPLE, address, spread, started

ALONE_S, ROUNDS, DOMAIN = 60.0, 6, "93"
VIEWS = {"type": "want", "views": ["images", "clouds", "tracks"]}
WIDTH, HEIGHT, POINTS = 1152, 896, 1_000_000


class Page:
    """One page that looks on and counts."""

    def __init__(self) -> None:
        self.took: list[float] = []
        self.late: list[float] = []
        self.media = 0

    async def look(self, url: str, seconds: float, *, views: bool = True) -> None:
        end = time.monotonic() + seconds
        async with aiohttp.ClientSession() as session, session.ws_connect(url + "ws", max_msg_size=0) as channel:
            if views:
                await channel.send_json(VIEWS)
            while (left := end - time.monotonic()) > 0:
                try:
                    message = await channel.receive(left)
                except TimeoutError:
                    return
                if message.type is aiohttp.WSMsgType.BINARY:
                    self.media += len(message.data)
                elif message.type is not aiohttp.WSMsgType.TEXT:
                    return
                elif (content := json.loads(message.data))["type"] == "calls" and not content["whole"]:
                    calls = [call for call in content["calls"] if call["node"] == "localisation_node"]
                    self.took += [call["processing_time_s"] for call in calls]
                elif content["type"] == "path" and not content["whole"]:
                    self.late += [time.time() - row[3] for row in content["rows"] if row[3] is not None]


async def never_reads(url: str, seconds: float) -> None:
    """Ask for everything, read nothing; connect again once cut off."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        async with aiohttp.ClientSession() as session, session.ws_connect(url + "ws", max_msg_size=0) as channel:
            await channel.send_json(VIEWS)
            await asyncio.sleep(min(30.0, left))


async def state_of(url: str) -> dict[str, Any]:
    async with aiohttp.ClientSession() as session, session.get(url + "state.json") as answer:
        return dict((await answer.json())["live"])


async def clients(place: Path, minutes: float) -> None:
    seconds, memory = minutes * 60.0 / ROUNDS, list[str]()
    alone, pages = Page(), [Page() for _ in range(3)]
    replay = started(place / "log", "replay", SAMPLE, "--start", "truth", "--rate", "5", "--loop", *LIVE)
    os.nice(10)  # the pages would be on other machines
    try:
        url = await address(place / "log")
        children = psutil.Process(replay.pid).children(recursive=True)
        server = next(child for child in children if "nodes.live_page" in " ".join(child.cmdline()))
        while not (await state_of(url))["poses"]:
            await asyncio.sleep(0.5)
        for _ in range(ROUNDS):
            await alone.look(url, ALONE_S, views=False)
            await asyncio.gather(never_reads(url, seconds), *(page.look(url, seconds) for page in pages))
            memory.append(f"{server.memory_info().rss / 1e6:.1f}")
        state = await state_of(url)
    finally:
        replay.terminate()
        replay.wait(30)
    print(f"localisation: {spread(alone.took)} without pages, {spread(pages[0].took)} with")
    print(f"server memory after each round: {', '.join(memory)} MB; the server: {state['server']}")
    print(f"each page: {pages[0].media / seconds / ROUNDS / 1e6:.2f} MB/s of images and clouds")


async def load(place: Path, seconds: float) -> None:
    os.environ["ROS_DOMAIN_ID"] = DOMAIN
    page, found = started(place / "log", "live", "--port", "0", domain=DOMAIN), Page()
    try:
        url = await address(place / "log")
        looking = asyncio.create_task(found.look(url, seconds + 6.0))
        sent = await asyncio.to_thread(publish_load, seconds)
        await looking
        state = await state_of(url)
    finally:
        page.terminate()
        page.wait(30)
    print(f"{sent} poses sent, {state['poses']} received; from image to page {spread(found.late)}")
    print(f"{found.media / seconds / 1e6:.2f} MB/s of images and clouds; the server: {state['server']}")


def publish_load(seconds: float) -> int:
    """Publish for some time; return how many poses."""
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import Image, PointCloud2

    from sfr_loc_map.geometry.cloud import PointCloud
    from sfr_loc_map.nodes.messages.fields import byte_array, header_msg
    from sfr_loc_map.nodes.messages.point_cloud import cloud_msg

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node, qos = rclpy.create_node("load_publisher"), QoSProfile(depth=5)
    images = [node.create_publisher(Image, f"loc/{side}/image_rect", qos) for side in ("left", "right")]
    odometry = node.create_publisher(Odometry, "localisation/odometry", qos)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    clouds = node.create_publisher(PointCloud2, "mapping/points", latched)
    rng, records = np.random.default_rng(1), np.zeros(POINTS, PointCloud.dtype())
    for name in "xyz":
        records[name] = rng.uniform(-5.0, 5.0, POINTS)
    cloud, pixels = PointCloud.from_structured(records), byte_array(rng.integers(0, 255, (HEIGHT, WIDTH), np.uint8))
    time.sleep(2.0)  # discovery
    begin, sent = time.monotonic(), 0
    while time.monotonic() - begin < seconds:
        header = header_msg(time.time_ns(), "ds")
        for publisher in images:
            image = Image(header=header, height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH, data=pixels)
            publisher.publish(image)
        message = Odometry(header=header, child_frame_id="rb")
        message.pose.pose.position.x, message.pose.pose.orientation.w = 0.01 * sent, 1.0
        odometry.publish(message)
        if sent % 50 == 0:
            clouds.publish(cloud_msg(cloud, time.time_ns(), "lm"))
        sent += 1
        time.sleep(max(begin + sent / 10.0 - time.monotonic(), 0.0))
    time.sleep(1.0)
    node.destroy_node()
    rclpy.try_shutdown()
    return sent


async def main(kind: str, amount: str = "30") -> None:
    with tempfile.TemporaryDirectory() as name:
        await {"clients": clients, "load": load}[kind](Path(name), float(amount))


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
