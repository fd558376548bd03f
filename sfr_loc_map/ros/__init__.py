"""Parts of every program with a ROS node.

    environment ──► rclpy ──► peer (node of a program beside the nodes of the suite)
    (variables, domain)        │ publishers: who publishes a topic, with which type and quality of service
                               │ services: calls of the nodes' services
                               │ truth_subscription: true poses, with the published type
                               ▼
    values ◄── messages ──► topics, with the profiles of qos
               statuses: /diagnostics; static_transforms: /tf_static
                               │
                               ▼
                           transport: latency and losses of received messages

`environment` prepares a process for ROS and chooses its domain. `processes` starts, watches and ends child processes:
programs of this package, and commands of the user. `profiles` has the shared-memory settings of Fast DDS. `messages`
has the parts of all messages; `pose_messages`, `image_messages`, `point_messages` and `grid_messages` convert values of
the layers below to messages, and messages to such values.
"""
