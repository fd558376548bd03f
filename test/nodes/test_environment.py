import socket
from collections import deque

import pytest

from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes import environment


def test_isolate_keeps_what_the_user_chose_and_takes_no_domain_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    variables = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    environment.isolate(variables)
    assert variables == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    monkeypatch.setattr(environment, "_held", deque())
    fresh: dict[str, str] = {}
    environment.isolate(fresh)
    assert fresh["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    domain = int(fresh["ROS_DOMAIN_ID"])
    monkeypatch.setattr(environment.random, "sample", lambda *_: [domain])
    with pytest.raises(NodeError, match="ROS domains 1 to 101 are in use"):
        environment.free_domain()  # another process that asks before the first has participants
    environment._held.pop().close()
    for participant in (0, 3):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            with pytest.raises(NodeError, match="ROS domains 1 to 101 are in use"):
                environment.free_domain()
    assert environment.free_domain() == domain
    environment._held.pop().close()
