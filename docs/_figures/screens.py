"""Make the images of the landing page, the tutorials and the report: `make screens`. It takes some minutes.

The sample is replayed through the nodes; its live page is filmed in a headless Chromium, and the pages that the
commands write are opened there. Nothing is drawn by hand.
"""

from __future__ import annotations

import asyncio
import base64
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from helpers.browser import Browser

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images" / "screens"
WORK = Path("out") / "screens"  # relative, as reports name their inputs
SAMPLE = Path("sample") / "sample.mcap"
LIMITS = ("--limits", Path("sample") / "limits.yaml")
SFR = (str(Path(sys.executable).with_name("sfr")),)
FILM_S, FRAMES, FILM_SIZE, SHOWN_WIDTH, RATE, SOURCE_S = 10.0, 50, (1180, 1200), 880, 1, 95.0
LARGEST_FILM_BYTES = 3_000_000
LIVE_SHOTS = (
    ("live-light", 1280, 1260, "light"),
    ("live-dark", 1280, 1260, "dark"),
    ("live-phone", 390, 2400, "light"),
)

FILMED = """
const sheet = new CSSStyleSheet();
sheet.replaceSync("main > section:not(#figures, #path, #growth, #cameras) { display: none }");
document.adoptedStyleSheets.push(sheet);
"""
RUN = """
const figures = ["top-view", "cloud"].map((name) => document.getElementById("figure-" + name));
const row = Object.assign(document.createElement("div"), {className: "figures", id: "run-figures"});
row.append(...figures);
document.querySelector("main").replaceChildren(document.getElementById("overall"), row);
for (const figure of figures) {
  const plot = figure.querySelector(".plot");
  figure.style.gridColumn = figure === figures[0] ? "span 2" : "span 4";
  figure.querySelector("figcaption").lastChild.remove();
  plot.style.height = "470px";
  Plotly.relayout(plot, {height: 470, autosize: true});
}
null;
"""
"""Leaves of a report its verdict, the path with its errors and the cloud, beside each other."""

PYTHON = """
import sys
import sfr_loc_map as sfr
source = sfr.open(sys.argv[1])
estimate = sfr.localise(source, start="truth")
sfr.score(estimate, source, ["distance=5"]).plot("position").write_html(sys.argv[2], config={"displayModeBar": False})
"""


def sfr(*words: object, codes: Sequence[int] = (0,)) -> None:
    """Run a command of the suite."""
    done = subprocess.run([*SFR, *map(str, words)], cwd=ROOT, stdout=subprocess.DEVNULL)
    if done.returncode not in codes:
        raise SystemExit(f"sfr {words[0]}: exit code {done.returncode}")


def save(image: Image.Image, name: str) -> None:
    """Write an image of the site."""
    image.convert("RGB").save(IMAGES / f"{name}.webp", quality=80, method=6)
    print(f"{name}: {image.width} x {image.height}, {(IMAGES / f'{name}.webp').stat().st_size / 1e3:.0f} kB")


async def shot(browser: Browser, *selectors: str) -> Image.Image:
    """Return what the page shows of all elements that the selectors name."""
    boxes = f"{list(selectors)}.map(s => document.querySelector(s).getBoundingClientRect())"
    edges = "[Math.min(...b.map(r => r.left)), Math.min(...b.map(r => r.top)), Math.max(...b.map(r => r.right))"
    edges += ", Math.max(...b.map(r => r.bottom))]"
    left, top, right, bottom = await browser.value(f"(() => {{ const b = {boxes}; return {edges}; }})()")
    left, top = max(left - 6, 0), max(top - 6, 0)
    clip = {"x": left, "y": top, "width": right + 6 - left, "height": bottom + 6 - top, "scale": 1}
    said = await browser.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)
    return Image.open(io.BytesIO(base64.b64decode(said["data"])))


async def opened(browser: Browser, page: Path) -> None:
    """Open a page that a command wrote, and wait until its figures are drawn."""
    await browser.open(page.absolute().as_uri())
    await browser.call("Emulation.setScrollbarsHidden", hidden=True)
    await browser.wait_for("document.readyState === 'complete'")
    await asyncio.sleep(3.0)


async def film(url: str) -> list[Image.Image]:
    """Return images of the live page while a replay goes on."""
    width, height = FILM_SIZE
    frames = []
    async with Browser(width, height) as browser:
        await browser.open(url)
        await browser.wait_for("document.readyState === 'complete'")
        await browser.wait_for("document.body.innerText.includes('tracking')", 300)  # a first start compiles
        await browser.value(FILMED)
        begin = time.monotonic()
        for number in range(FRAMES):
            await asyncio.sleep(max(0.0, begin + number * SOURCE_S / RATE / FRAMES - time.monotonic()))
            said = await browser.call("Page.captureScreenshot", format="png")
            image = Image.open(io.BytesIO(base64.b64decode(said["data"]))).convert("RGB")
            frames.append(image.resize((SHOWN_WIDTH, SHOWN_WIDTH * height // width), Image.Resampling.LANCZOS))
    return frames


async def page_shots(url: str) -> None:
    """Save the live page in three looks: light, dark, and on a phone."""
    async with Browser(1280, 900) as browser:
        await browser.open(url)
        await browser.wait_for("document.documentElement.dataset.poses > 100", 400)  # a first start compiles
        for name, width, height, scheme in LIVE_SHOTS:
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            await browser.call("Emulation.setDeviceMetricsOverride", **size)
            await browser.call("Emulation.setScrollbarsHidden", hidden=True)
            features = [{"name": "prefers-color-scheme", "value": scheme}]
            await browser.call("Emulation.setEmulatedMedia", features=features)
            await asyncio.sleep(2.0)  # until all plots are drawn again
            await browser.wait_for("document.getElementById('connection').textContent.includes('connected')")
            said = await browser.call("Page.captureScreenshot", format="png")
            image = Image.open(io.BytesIO(base64.b64decode(said["data"])))
            image.convert("RGB").save(IMAGES.parent / f"{name}.webp", quality=80, method=6)


async def film_and_shots(url: str) -> list[Image.Image]:
    """Film the live page, and save shots of it meanwhile."""
    frames, _ = await asyncio.gather(film(url), page_shots(url))
    return frames


def make_film() -> None:
    """Replay the sample, film its live page."""
    words = ("replay", SAMPLE, "--start", "truth", "--rate", RATE, "--live", "--live-port", 0)
    command = [*SFR, *map(str, (*words, *LIMITS, "--out", WORK / "filmed"))]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as replay:
        assert replay.stdout is not None
        url = next(found[0] for line in replay.stdout if (found := re.search(r"http://\S+", line)))
        frames = asyncio.run(film_and_shots(url))
        replay.send_signal(signal.SIGINT)  # the page of an ended run is served until then
        replay.stdout.read()
    if replay.returncode not in (0, 130):
        raise SystemExit(f"sfr replay: exit code {replay.returncode}")
    place = IMAGES / "live.webp"
    duration = round(1000 * FILM_S / FRAMES)
    frames[0].save(
        place,
        save_all=True,
        append_images=frames[1:],
        duration=duration,
        loop=0,
        quality=55,
        method=6,
        minimize_size=True,
    )
    print(f"live: {len(frames)} images, {place.stat().st_size / 1e6:.2f} MB")
    if place.stat().st_size > LARGEST_FILM_BYTES:
        raise SystemExit("the film is larger than 3 MB")


def run_commands() -> None:
    """Make the pages that are shown."""
    sfr("replay", SAMPLE, "--start", "truth", *LIMITS, "--out", WORK / "run")
    for name in ("sfr", "opencv"):
        estimate, stats = WORK / f"{name}.csv", ("--stats", WORK / f"{name}.stats.csv")
        sfr("localise", SAMPLE, "--start", "truth", "-o", estimate, *stats, "--method", name)
        sfr("score", estimate, SAMPLE, *stats, "--condition", "distance=5", "--json", WORK / f"{name}.json")
    sfr("report", WORK / "sfr.json", WORK / "opencv.json", "-o", WORK / "comparison.html", codes=(0, 3))
    sfr("report", WORK / "sfr.csv", WORK / "opencv.csv", "--truth", SAMPLE, "-o", WORK / "paths.html")
    sfr("report", WORK / "run" / "report.json", "--test-report", WORK / "signed.html")
    suite = WORK / "suite.yaml"
    suite.write_text(
        f"sources: [{ROOT / SAMPLE}]\nperturb: [noisy, blurred, dirt]\ntasks: [localise]\n", encoding="utf-8"
    )
    sfr("suite", "run", suite, "--out", WORK / "suite", codes=(0, 3))
    subprocess.run([sys.executable, "-c", PYTHON, SAMPLE, WORK / "python.html"], cwd=ROOT, check=True)


async def take_shots() -> None:
    """Open each page, save what the site shows of it."""
    async with Browser(1280, 900) as browser:
        await opened(browser, WORK / "run" / "report.html")
        save(await shot(browser, "header", "#look-first"), "report-top")
        for name in ("top-view", "position", "localisation-timeline", "over-range", "image-0", "cloud", "accumulated"):
            save(await shot(browser, f"#figure-{name}"), f"report-{name}")
        await browser.value(RUN)
        await asyncio.sleep(3.0)
        save(await shot(browser, "#overall", "#run-figures"), "run")
        await opened(browser, WORK / "python.html")
        save(await shot(browser, ".plotly-graph-div"), "python")
        for page in ("comparison.html", "paths.html", "suite/report.html", "signed.html"):
            await opened(browser, WORK / page)
            image = await shot(browser, "body")
            save(image.crop((0, 0, image.width, min(image.height, 880))), page.removesuffix(".html").partition("/")[0])


def main() -> None:
    """Make all images."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    os.chdir(ROOT)
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    make_film()
    run_commands()
    asyncio.run(take_shots())


if __name__ == "__main__":
    main()
