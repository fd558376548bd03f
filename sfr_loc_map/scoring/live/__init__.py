"""The score of a run in progress, from received messages, without ROS.

    messages ── monitor_score ─┬─ received_rows: estimates, true poses, calls ─┬─ live_score ── Score
                               └─ live_maps: clouds and their truth, worst map ┘

`MonitorScore` receives the messages. The rows and the worst map belong to the current run and are discarded at a
restart. The clouds and their truth are kept, because clouds of the new run may arrive before this run is detected.

The received rows are scored by the functions that score files (`scoring.results`), so that the figures of a live
score are bit-identical to those of a recording. The finding about the conventions may differ, because the diagnosis has
no rig and is repeated only when the number of poses has grown by a fifth.
"""
