"""Run the commands of the tutorials exactly as they are on the pages: `make docs-test`.

All ```sh and ```python blocks of a page are run in order. All pages are run one after the other in one folder, as by a
user in a clone: `sample`, `config` and `examples` are those of the repository. Each page begins in this folder, and
`cd` is respected. For docs/python.md, `data` is the sample as a folder. A comment before a block changes how the block
is run. `<!-- slow -->` excludes the block from the quick test (test_tutorials.py). `<!-- until Ctrl-C -->` marks a
command that runs until it is interrupted at the end of the page. Blocks that need other software (```console) are not
run.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from sfr_loc_map.ros import environment as nodes_environment

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*(ROOT / "docs" / "tutorials").glob("*.md"), ROOT / "docs" / "python.md"])
BLOCK = re.compile(r"(?:<!-- (slow|until Ctrl-C) -->\n)?```(sh|python)\n(.*?)```", re.DOTALL)
STARTED_S, BLOCK_S = 15.0, 900.0


class Block(NamedTuple):
    """A block of commands: its comment, its language (`sh` or `python`) and its text."""

    note: str
    language: str
    code: str


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page in order."""
    return [Block(*found) for found in BLOCK.findall(page.read_text(encoding="utf-8"))]


def run_page(page: Path, folder: Path) -> None:
    """Run all blocks of a page; RuntimeError names the block that fails."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path}
    nodes_environment.isolate(environment)
    if '"data"' in page.read_text(encoding="utf-8"):
        subprocess.run(["sfr", "convert", "sample/sample.mcap", "data"], cwd=folder, env=environment, check=True)
    names: dict[str, Any] = {}
    running: list[tuple[Block, subprocess.Popen[bytes]]] = []
    os.chdir(folder)
    try:
        for block in blocks(page):
            began = time.monotonic()
            if block.language == "python":
                exec(compile(block.code, str(page), "exec"), names)  # the page is part of the repository
            elif block.note == "until Ctrl-C":
                command = ["bash", "-c", f"exec {block.code}"]
                running.append((block, subprocess.Popen(command, env=environment, start_new_session=True)))
                time.sleep(STARTED_S)
                if running[-1][1].poll() is not None:
                    raise RuntimeError(f"{page.name}: ended before Ctrl-C: {block.code}")
            else:
                code = f"{block.code}\npwd > {folder}/.place"
                done = subprocess.run(["bash", "-euc", code], env=environment, timeout=BLOCK_S)
                if done.returncode:
                    raise RuntimeError(f"{page.name}: exit code {done.returncode}: {block.code}")
                os.chdir((folder / ".place").read_text().strip())
            print(f"{page.name}: {time.monotonic() - began:.1f} s: {block.code.splitlines()[0]}", flush=True)
    finally:
        for block, process in reversed(running):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            code = process.wait(60)
            print(f"{page.name}: exit code {code} after Ctrl-C: {block.code.strip()}", flush=True)
    if any(process.returncode not in (0, 130) for _, process in running):
        raise RuntimeError(f"{page.name}: a command returned neither 0 nor 130 after Ctrl-C")


def main() -> int:
    """Run the pages on the command line, or all pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", nargs="*", type=Path, help="pages; by default all tutorials")
    failed = []
    signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs and their children ignore SIGINT
    pages = [path.resolve() for path in parser.parse_args().page] or PAGES
    with tempfile.TemporaryDirectory(prefix="tutorial-") as folder:
        for name in ("sample", "config", "examples"):
            (Path(folder) / name).symlink_to(ROOT / name)
        for page in pages:
            try:
                run_page(page, Path(folder))
            except Exception as error:  # continue with the next page
                failed.append(page.name)
                print(f"FAILED {page.name}: {error}", flush=True)
            finally:
                os.chdir(ROOT)
    print(f"failed: {', '.join(failed)}" if failed else "all commands of all tutorials work")
    return bool(failed)


if __name__ == "__main__":
    raise SystemExit(main())
