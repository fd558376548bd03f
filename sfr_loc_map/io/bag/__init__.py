"""Bags of ROS 2 and ROS 1, and the conversion between their messages and the values of the suite.

`files`, `encoding`, `unpacking` and `mcap_file` are the parts of `readers`, which open one file or folder. `bag` reads
the topics of a bag as a stream by their `topic_names`, and `poses` its poses and frames. `frames` collects frames from
messages of a bag or of a graph. `messages` makes messages, `writer` writes them, and `recorder` records messages as
they arrive.
"""
