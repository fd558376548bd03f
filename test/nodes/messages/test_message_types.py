import pytest
from rosbags.typesys import Stores, get_typestore

from sfr_loc_map.errors import NodeError
from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.messages import message_types
from sfr_loc_map.nodes.messages.message_types import UNKNOWN_HASH, definition_of, message_type


def test_types_that_are_not_installed_are_named_and_recorded_without_definition() -> None:
    assert message_type("nav_msgs/msg/Odometry").__name__ == "Odometry"
    for name in ("no_such_msgs/msg/Odometry", "nav_msgs/msg/NoSuch"):
        with pytest.raises(NodeError, match=name):
            message_type(name)
        assert definition_of(name) == ("", UNKNOWN_HASH)


@pytest.mark.parametrize("name", ["nav_msgs/msg/Odometry", "sensor_msgs/msg/PointCloud2"])
def test_definitions_read_from_packages_are_those_of_the_library(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings: dict[str, str] = {}
    environment.prepare(settings)
    monkeypatch.setenv("AMENT_PREFIX_PATH", settings["AMENT_PREFIX_PATH"])
    known = definition_of(name)
    assert known == (TYPESTORE.generate_msgdef(name, ros_version=2)[0], TYPESTORE.hash_rihs01(name))
    monkeypatch.setattr(message_types, "TYPESTORE", get_typestore(Stores.EMPTY))
    monkeypatch.setattr(message_types, "get_typestore", lambda store: get_typestore(Stores.EMPTY))
    assert definition_of(name) == known
