"""Views of a run in progress.

    nodes ──► feed, map_feed (thread of ROS; `operator` calls the services of the nodes)
            │ records (`updates`)
            ▼
    LiveState.put (`state`): path, timeline, live_node, shown_score, freshness
            │ JSON values (`live_to_plain`, `to_plain`), images and maps
            ├──► server, viewer (event loop) ──► messages ──► web/app.js and a module for each panel
            └──► terminal

Only the feed writes the state. Each view reads the state while it holds `LiveState.lock`, and never delays the feed.
`headline` makes the verdict for all views, and `displayed_media` has which images and maps the feed must prepare.
`live_process` starts the page beside a run, as a process that runs `main`. By `run_end` the run reports to this process
how it ended. `config`, `access` and `connections` protect the server.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
