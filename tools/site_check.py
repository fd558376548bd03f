"""The built site in a browser: `make docs-check`.

Every page is opened at 1280 and at 390 px: all images are there, no code is cut at 1280, nothing is wider than a phone
but what scrolls within (tables, figures). The search finds what users look for.
"""

from __future__ import annotations

import asyncio
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from helpers.browser import Browser

SITE = Path(__file__).resolve().parents[1] / "out" / "docs"
WIDE, PHONE = 1280, 390
FOUND = {
    "zed": "ZED",
    "realsense": "RealSense",
    "FAQ": "FAQ",
    "sigma": "sigma",
    "covariance": "Conventions",
    "degraded": "The report",
    "extrinsics": "Extrinsics",
    "memory": "how memory is measured",
    "Dask": "Suites",
    "C candidate": "candidate",
    "limits": "limits file",
    "truth without attitude": "Truth without attitudes",
}
"""Searched words, and the text in the title or the excerpt of one of the first ten results."""
FAULTS = """
(() => {
  const faults = [];
  for (const image of document.images) if (!image.naturalWidth) faults.push("no image " + image.src);
  if (innerWidth > 1000)
    for (const code of document.querySelectorAll("pre"))
      if (code.scrollWidth > code.clientWidth + 1) faults.push("cut: " + code.innerText.slice(0, 50));
  const width = document.documentElement.scrollWidth;
  if (width > innerWidth + 1) faults.push("wider than the screen: " + width);
  for (const table of document.querySelectorAll("article table"))
    if (table.scrollWidth > innerWidth && !table.closest(".table-wrapper")) faults.push("a table is cut");
  return faults;
})()
"""
RESULTS = "[...document.querySelectorAll('#search-results li')].slice(0, 10).map(item => item.innerText)"


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing of each request."""


async def check(url: str) -> list[str]:
    """Return what is wrong with the site."""
    faults = []
    pages = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html") if "_static" not in path.parts)
    for width in (WIDE, PHONE):
        async with Browser(width, 900) as browser:
            for page in pages:
                await browser.open(url + page)
                await browser.wait_for("document.readyState === 'complete' && document.querySelector('article')")
                await browser.value("document.querySelectorAll('img').forEach(image => { image.loading = 'eager' })")
                await browser.wait_for("[...document.images].every(image => image.complete)")
                faults += [f"{page} at {width}: {fault}" for fault in await browser.value(FAULTS)]
    async with Browser(WIDE, 900) as browser:
        for words, expected in FOUND.items():
            await browser.open(f"{url}search.html?q={words}")
            await browser.wait_for("/finished|found|match/i.test(document.querySelector('.search-summary').innerText)")
            await asyncio.sleep(0.5)
            results = await browser.value(RESULTS)
            print(f"search {words}: {', '.join(str(item).splitlines()[0] for item in results[:4])}")
            if not any(expected.lower() in item.lower() for item in results):
                faults.append(f"search for '{words}' finds nothing with '{expected}'")
    print(f"{len(pages)} pages at {WIDE} and {PHONE} px: {len(faults)} faults")
    return faults


def main() -> int:
    """Serve the site, check it; return 1 if something is wrong."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(SITE))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        faults = asyncio.run(check(f"http://127.0.0.1:{server.server_address[1]}/"))
        server.shutdown()
    print("\n".join(faults))
    return bool(faults)


if __name__ == "__main__":
    raise SystemExit(main())
