"""Views of a run in progress. This package does not import ROS.

    nodes/view/feed.py (thread of ROS)
            │ records (`updates`)
            ▼
    LiveState.put (`state`): path, timeline, live_node, live_report, freshness
            │ JSON values (`live_to_plain`, `to_plain`), images and maps
            ├──► server, viewer (event loop) ──► messages ──► web/app.js and a module for each panel
            ├──► terminal
            └──► foxglove (its own thread)

Only the feed writes the state. Each view reads the state while it holds `LiveState.lock`, and never delays the feed.
`headline` makes the verdict for all views, and `displayed_media` has which images and maps the feed must prepare.
`run_end` reports from the process of the run to the process of the page how the run ended. `config`, `access` and
`connections` protect the server.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
