"""A command without a panel is in the help."""

from __future__ import annotations

import subprocess
import sys


def test_a_command_without_a_panel_is_in_the_help() -> None:
    """In a process of its own, because the panels are assigned when the command line is imported."""
    code = (
        "from sfr_loc_map.cli import app; "
        "app.PANELS.pop('Data'); "
        "import sys; sys.argv[1:] = ['--help']; "
        "from sfr_loc_map.cli.main import main; "
        "sys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert "simulate" in done.stdout
