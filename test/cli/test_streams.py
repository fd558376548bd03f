"""What nobody reads costs neither an output nor a verdict."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

BODY = """
import sys
from sfr_loc_map.cli import main
from sfr_loc_map.cli.output import say

def command(standalone_mode, prog_name):
    say("first")
    say("second", err=True)
    print("third")
    open("/dev/fd/{out}", "w").write("whole")
    return 1

main.app = command
sys.exit(main.main())
"""


def run_command(stdout: int | None, stderr: int | None) -> tuple[int, str]:
    """Return the exit code of a command with these streams (None: closed), and what it wrote to its output."""
    read_end, out = os.pipe()

    def close() -> None:
        for number, stream in ((1, stdout), (2, stderr)):
            if stream is None:
                os.close(number)

    process = subprocess.run(
        [sys.executable, "-c", BODY.format(out=out)],
        stdout=stdout,
        stderr=stderr,
        pass_fds=[out],
        preexec_fn=close,
        timeout=60,
        check=False,
    )
    os.close(out)
    with open(read_end, encoding="ascii") as stream:
        return process.returncode, stream.read()


def test_a_reader_that_leaves_costs_neither_output_nor_exit_code() -> None:
    reader, writer = os.pipe()
    os.close(reader)  # as `| head` does
    try:
        assert run_command(writer, writer) == (1, "whole")
    finally:
        os.close(writer)
    assert run_command(None, None) == (1, "whole")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="Linux")
def test_a_full_disk_is_an_error_of_standard_output_alone() -> None:
    with open("/dev/full", "wb") as full, open(os.devnull, "wb") as sink:
        assert run_command(sink.fileno(), full.fileno()) == (1, "whole")
        assert run_command(full.fileno(), sink.fileno()) == (2, "")
