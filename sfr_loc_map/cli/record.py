"""`sfr record`: topics into a bag that a crash leaves readable."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import NamespaceOption, require_ros
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import OverwriteOption, output_folder, say


@app.command(
    epilog=examples(
        "sfr record drive",
        "sfr record drive /loc/left/image_rect /loc/left/camera_info --duration 60 --zstd",
        "sfr record everything --all --namespace rover1",
    )
)
def record(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the bag (mcap).")],
    topics: Annotated[
        list[str] | None, typer.Argument(metavar="TOPIC", help="Topics; by default ours and our inputs.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="All topics.")] = False,
    namespace: NamespaceOption = "",
    duration: Annotated[
        float | None, typer.Option(min=0.0, metavar="S", help="How long; by default until Ctrl-C or SIGTERM.")
    ] = None,
    zstd: Annotated[bool, typer.Option("--zstd", help="Compress.")] = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Record topics; every half second all messages are on disk, so that a crash costs no more."""
    require_ros("record")
    from sfr_loc_map.nodes.tools.record import RecordOptions
    from sfr_loc_map.nodes.tools.record import record as run

    options = RecordOptions(tuple(topics or ()), everything, namespace, duration, zstd)
    with output_folder(out, overwrite=overwrite):
        counts = run(out, options, lambda text: say(text, err=True))
    count, lost = (sum(getattr(topic, name) for topic in counts.values()) for name in ("count", "lost"))
    propose("sfr", "doctor", out, why="is it complete")
    say(f"{out}: {count} messages of {sum(topic.count > 0 for topic in counts.values())} topics, {lost} lost")
    for name, topic in counts.items():
        if topic.lost:
            say(f"  {topic.lost} of {name} lost in transport", err=True)
