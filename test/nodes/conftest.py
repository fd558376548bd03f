"""Marks the tests that need ROS."""

import importlib.util
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

WITHOUT_ROS = (
    *("test_answer_book.py", "test_environment.py", "test_launch_parts.py", "test_odometry_buffer.py"),
    *("test_pose_matching.py", "test_received.py", "test_thinned_path.py", "test_transport.py", "test_worker.py"),
)
"""Files that import nothing of ROS."""


class Skipped(pytest.Module):
    def collect(self) -> list[pytest.Item]:
        pytest.skip("ROS is not installed: no module 'rclpy'", allow_module_level=True)


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> Generator[None, pytest.Module]:
    """Mark the tests that need ROS, and do not import them where it is absent."""
    module = yield
    if module_path.name in WITHOUT_ROS:
        return module
    if importlib.util.find_spec("rclpy") is None:
        module = Skipped.from_parent(parent, path=module_path)
    module.add_marker(pytest.mark.ros)
    module.add_marker(pytest.mark.timeout(240))
    return module


@pytest.fixture(autouse=True)
def isolated(own_domain: None) -> None:
    """Each test, whether it has nodes itself or starts them."""


@pytest.fixture
def ros(own_domain: None) -> Iterator[None]:
    """ROS within the test's process."""
    import rclpy

    rclpy.init(args=[])
    yield
    rclpy.try_shutdown()
