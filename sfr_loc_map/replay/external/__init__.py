"""An external node under test in a replay, in place of one of the suite's nodes (`external_node`).

`answer_converters` reads its messages, `answer_book` assigns them to the published pairs and counts them,
`process_watch` measures its process, and `publisher_check` detects another publisher. After the replay,
`external_poses` converts its poses for the score.
"""
