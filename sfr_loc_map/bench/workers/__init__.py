"""What runs in the processes of a bench; started as scripts, by the interpreter that has the peer.

`loop.py` feeds a peer; every other file is one peer with `open_peer(setup)`. `peer_*.py` and `loop.py` import nothing
of this package, so that an interpreter with nothing but NumPy, OpenCV and the peer can run them.
"""
