"""The three ROS 2 nodes, and the processes in which they run.

The path of a stereo pair through a node, in two threads:

    executor's thread   `input.stereo_input` (images to pairs, by stamps and runs)
                        -> `pair_node` -> `localisation_node`, or `mapping_node` (waits for the pose of the pair)
    worker's thread     -> the localiser or the mapper -> results, and the call record

`monitor_node` passes results and ground truth to its worker in the same way, scores them (`scoring.live`), and
publishes the score (`score_publisher`) or saves it (`score_file`).

- `lifecycle`: what the three nodes have in common (`managed_node`): states, parameters, endpoints, health
- `input`: reception of pairs, poses, extrinsics and true poses; what a node waits for (`missing_input`)
- `launch`: the nodes as processes; `start` is the first module of such a process
- `localisation_session`: the localiser of the node, with its start pose; `pose_file`: the pose at which a new process
  resumes
- `parameter_files`: writes the files in `config/`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
