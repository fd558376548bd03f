"""The three ROS 2 nodes, and the processes in which they run.

A node receives messages in the executor's thread, and processes them in order in the worker's thread. The localisation
node and the mapping node receive stereo pairs; the monitor node receives the results of both.

    executor's thread                                          worker's thread

    images ──► stereo (pairs) ──► pair_node ──┬─► queue ──► localisation_node (localisation) ──► odometry, call
                                              └─► queue ──► mapping_node ──────────────────────► cloud, call
    results, ground truth ──► monitor_node (monitor) ──► queue ──► the score ──────────────────► report
    └─────────────── lifecycle: states, parameters, publishers, the worker and its queue, health ──────────────┘

- `stereo`: combines images into pairs by their stamps and runs (`stereo_input`), assigns poses to pairs
  (`pose_matching`), and states what a node waits for (`missing_input`)
- `pair_node`: what the localisation node and the mapping node have in common
- `localisation_node`, `mapping_node`, `monitor_node`: the nodes; `localisation` and `monitor` are their parts
- `lifecycle`: what the three nodes have in common (`managed_node`)
- `launch`: the nodes as processes. `start` is the first module of such a process, and `lifecycle.runner` runs its node.

`parameter_files` writes the files in `config/` from the parameters of the nodes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
