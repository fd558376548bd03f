"""Replay a source through the running nodes.

    source, options ──► scored_replay ──► session: arguments_by_node ──► processes of the nodes
                                             │                              ▲ messages    │ results
                                             │           player ────────────┘             ▼
                                             │           (lock step: waits for) ◄── collector, external ──► answer_book
                                             ▼                                            │
                    score, files ◄── result ◄── received ◄────────────────────────────────┘

`scored_replay` replays, saves and scores; the steps of a replay are in `session`:

1. `started_participants` starts each node as a process with its parameters (`arguments_by_node`), and an external node
   if there is one (`external`). `replay_peer` is the ROS node of the replay, to which player and collector belong.
2. `play_and_collect` publishes the messages of the source when they are due (`player`). After each complete pair, the
   `collector` notes the pair and, in lock step, waits for its results. At the end of the source, the collector waits
   for the missing results.

`options` has what is replayed and how. `received` stores the published pairs and the received results, which
`scored_replay` owns, so that they are saved even if the replay fails. `result` has the results of a replay, `files`
writes them, and `score` scores them. `answer_book` counts the answers of an external node, `process_watch` measures
its process, and `external_poses` converts its poses after the replay.
"""
