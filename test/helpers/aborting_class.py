"""A class under test that ends its process at the eighth call."""

import os


class Aborting:
    calls = 0

    def __init__(self, rig: object, config: object) -> None:
        pass

    def process(self, pair: object) -> None:
        self.calls += 1
        if self.calls == 8:
            os.abort()
