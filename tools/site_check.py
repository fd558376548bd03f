"""Check the built site in a browser: `make docs-check`.

Every page is opened at 1280 and 390 px. All images must load, code must not be cut off at 1280 px, and only scrollable
tables and figures may be wider than a phone. The search must find common terms.
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
"""Search terms, and the text that is required in one of the first ten results."""
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
        """Do not log requests."""


async def check(url: str) -> list[str]:
    """Return the faults of the site."""
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
    """Serve and check the site; return 1 if there are faults."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(SITE))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        faults = asyncio.run(check(f"http://127.0.0.1:{server.server_address[1]}/"))
        server.shutdown()
    print("\n".join(faults))
    return bool(faults)


if __name__ == "__main__":
    raise SystemExit(main())
