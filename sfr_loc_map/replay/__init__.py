"""Replay a source through the running nodes.

    source, options ──► session.replay ──► ReplayResult ──► external_poses ──► files ──► replay_score
                                                                                                │
                                                                                                ▼ Score
    in session.replay:
    arguments_by_node ──► processes of the nodes ──► messages ──► collector, external ──► message_store ──► ReplayResult
                            ▲                                                                 ▲
    player ── messages ─────┴── completed pairs ──────────────────────────────────────────────┴──► waiting

`replay_command` is the work of `sfr replay`: replay, convert the poses of an external localiser, write the files,
score.
`session` starts the processes of the nodes, and connects all nodes of the replay (`connected_replay`). The `Connected`
replay then plays the source (`play_and_collect`):

- `player` publishes the messages of the source when they are due. `replay_peer` is the ROS node of the replay.
- `collector` receives the results of the suite's nodes and all calls, and `external` the poses or clouds of a node
  under test. Both add them to `message_store`, which has a store for each task and also contains the published pairs.
  Its `result` is the `ReplayResult`.
- `waiting` waits for the results of each published pair in lock step, and for the missing results at the end. The
  node of each task is an `AwaitedNode`: a node of the suite, or the external node.

`options` has what is replayed and how. Of an external node, `answer_converters` reads the messages, `answer_book`
counts the answers, `process_watch` measures the process, and `publisher_check` detects another publisher.
"""
