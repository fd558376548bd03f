"""Views of a run in progress: the live page and the terminal.

A run is a sequence of increasing stamps that the nodes process; if the stamps jump back, a new run begins. A record has
the content of a received message without ROS types.

    topics ──► feed (thread of ROS), map_feed (worker)   nodes ◄── operator ◄── commands (the buttons of a page)
            │ records (`updates`)
            ▼
    LiveState.put (`state`): path, call_log, node_reports, freshness, timeline, shown_score, run_end
            │ JSON values (`values`), images and maps
            ├──► server, viewer (event loop) ──► messages ──► web/app.js and a module for each panel
            └──► terminal

Only `feed` and `map_feed` write received data to the state. The server adds the end of the run, and `messages` and
`terminal` advance the time of the timeline (`LiveState.tick`). All views show the same `values`, whose verdict is
composed by `headline`. Each view reads the state while it holds `LiveState.lock`, and never delays the feed. The feed
prepares images and maps only while a page is visible (`LiveState.watch`).
`page_process` starts the page beside `sfr run` or a replay, as a process that runs `main`. `run_end` reports to the
process of the page how the run ended. `config`, `access` and `connections` protect the server.

A panel is added in these places:

- a section in `web/index.html`, whose id is the name of the panel,
- a module `web/NAME.js` with the function that draws the panel, and its row in `panels` of `web/app.js`,
- the explanation of its terms in `web/terms.js`,
- for data that the page does not yet receive: a record in `updates`, its source in `feed`, and its case in `_take_in`
  of `state`. If it is a value in `live_values` of `values`, the page receives it in the message `live`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
