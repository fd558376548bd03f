"""Live scores of random orders of messages: `python -m campaigns message-orders [--drives 250] [--orders 20]`.

The score of the monitor must be that of the file, to the last digit, for each order of the messages of each drive.
"""

from __future__ import annotations

import argparse

from helpers.message_orders import check_orders


def main(arguments: list[str]) -> int:
    """Check the orders of each drive and print their number; an order with another score raises AssertionError."""
    parser = argparse.ArgumentParser(prog="python -m campaigns message-orders")
    parser.add_argument("--drives", type=int, default=250)
    parser.add_argument("--orders", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    flags = sum(check_orders(seed, given.orders) for seed in range(given.seed, given.seed + given.drives))
    print(f"{given.drives * given.orders} orders of {given.drives} drives: every live score is that of the file")
    print(f"{flags} of the poses were lost or degraded")
    return 0
