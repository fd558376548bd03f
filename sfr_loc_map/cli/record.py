"""`sfr record`: record topics to a bag that survives a crash."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import NamespaceOption, OverwriteOption, require_ros
from sfr_loc_map.cli.output import output_folder, say


@app.command(
    epilog=examples(
        "sfr record drive",
        "sfr record drive /loc/left/image_rect /loc/left/camera_info --duration 60 --zstd",
        "sfr record everything --all --namespace rover1",
    )
)
def record(
    out: Annotated[Path, Argument(metavar="OUT", help="Folder of the bag (mcap).")],
    topics: Annotated[
        list[str] | None, Argument(metavar="TOPIC", help="Topics; default: the inputs and outputs of the nodes.")
    ] = None,
    everything: Annotated[bool, Option("--all", help="Record all topics.")] = False,
    namespace: NamespaceOption = "",
    duration: Annotated[float | None, Option(min=0.0, metavar="S", help="Duration; default: until Ctrl-C.")] = None,
    zstd: Annotated[bool, Option("--zstd", help="Compress with zstd.")] = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Record topics. Messages are written to disk every half second, so that a crash loses at most half a second."""
    require_ros("record")
    from sfr_loc_map.graph.record import RecordOptions
    from sfr_loc_map.graph.record import record as run_recorder

    options = RecordOptions(tuple(topics or ()), everything, namespace, duration, zstd)
    with output_folder(out, overwrite=overwrite, resumable=True) as place:
        if place != out:
            say(f"recording into {place}, which will replace {out} when the recording ends", err=True)
        counts = run_recorder(place, options, lambda text: say(text, err=True))
    count, lost = (sum(getattr(topic, name) for topic in counts.values()) for name in ("count", "lost"))
    propose("sfr", "info", out, why="checks that it is complete")
    say(f"{out}: {count} messages of {sum(topic.count > 0 for topic in counts.values())} topics, {lost} lost")
    for name, topic in counts.items():
        if topic.lost:
            say(f"  {topic.lost} messages of {name} lost in transport", err=True)
