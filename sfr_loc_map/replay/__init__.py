"""Replay a source through the running nodes.

    command line ──► options ──► session ──────────────────► results ──────► score and files
                                 │ processes of the nodes    ▲
                                 │ player ──► nodes ─────────┤ collector
                                 │ waiting ◄─────────────────┤
                                 │        └─► external node ─┘ external

- **Options.** `options` defines what is replayed, and how.
- **Session.** `session` starts the processes of the nodes (`arguments_by_node`), waits until all nodes communicate
  (`connected_replay`), and plays the source (`play_and_collect`). `played_pairs` selects the messages and reports the
  last message of each pair, `player` publishes each message when it is due, and `waiting` waits for the results of
  each pair in lock step, and for missing results at the end. Both use the ROS node of the replay (`replay_peer`).
- **Results.** `collector` receives the results of the suite's nodes and all calls. `message_store` contains them, with
  the published pairs, and returns the `ReplayResult` (`result`).
- **External node.** `external` is a node under test in place of one of the suite's nodes. Its results are added to the
  same store.
- **Score and files.** `replay_command` is the work of `sfr replay`: replay, write the files (`files`), and score the
  result (`replay_score`).
"""
