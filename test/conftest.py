"""Fixtures, markers and settings of all tests."""

import functools
import gc
import importlib.util
import os
import signal
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path

import hypothesis
import pytest
import typer.main

from helpers.cli_result import Sfr, run_sfr
from sfr_loc_map.signals import END_SIGNALS

os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")  # before any message class is imported

# A collection keeps all that it makes: searching it for garbage takes a fifth of its time.
gc.disable()

# The time of an example depends on the load of the host, so no example has a deadline.
hypothesis.settings.register_profile(
    "busy_host", deadline=None, max_examples=30, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("busy_host")

# `sfr` is called thousands of times in one process: typer would make its 26 commands again for each call.
typer.main.get_command = functools.cache(typer.main.get_command)

# A shell that runs the tests in its background has them, and what they start, ignore Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

TESTS = Path(__file__).resolve().parent
ROS_TESTS = (
    "graph",
    "nodes",
    "replay",
    "ros",
    "live/test_feed.py",
    "live/test_page_process.py",
    "live/test_map_feed.py",
)
"""Folders and files of tests whose modules import ROS."""
WITHOUT_ROS = (
    "nodes/launch/test_launch_parts.py",
    "nodes/launch/test_node_sections.py",
    "nodes/localisation/test_localisation_session.py",
    "nodes/localisation/test_odometry_buffer.py",
    "nodes/localisation/test_thinned_path.py",
    "nodes/stereo/test_pose_matching.py",
    "replay/test_answer_book.py",
    "replay/test_message_store.py",
    "replay/test_replay_score.py",
    "ros/test_environment.py",
    "ros/test_transport.py",
)
"""Files in these folders that import nothing of ROS."""
assert all((TESTS / name).exists() for name in (*ROS_TESTS, *WITHOUT_ROS))
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@functools.cache
def is_ros_test(path: Path) -> bool:
    """Return whether a file of tests is in `ROS_TESTS`."""
    return any(path.is_relative_to(TESTS / name) for name in ROS_TESTS)


class Skipped(pytest.Module):
    def collect(self) -> list[pytest.Item]:
        pytest.skip("ROS is not installed: no module 'rclpy'", allow_module_level=True)


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> Generator[None, pytest.Module]:
    """Mark the tests that need ROS, and do not import them where it is absent."""
    module = yield
    if not is_ros_test(module_path) or module_path.relative_to(TESTS).as_posix() in WITHOUT_ROS:
        return module
    if importlib.util.find_spec("rclpy") is None:
        module = Skipped.from_parent(parent, path=module_path)
    module.add_marker(pytest.mark.ros)
    module.add_marker(pytest.mark.timeout(240))
    return module


@pytest.fixture(autouse=True)
def _isolated(request: pytest.FixtureRequest) -> None:
    """Each test of `ROS_TESTS` has its own domain, whether it has nodes itself or starts them."""
    if is_ros_test(request.node.path):
        request.getfixturevalue("own_domain")


@pytest.fixture
def ros(own_domain: None) -> Iterator[None]:
    """ROS within the test's process."""
    import rclpy

    rclpy.init(args=[])
    yield
    rclpy.try_shutdown()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the development data; the test is skipped where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("the development data is not beside this checkout")
    return SHARED


@pytest.fixture
def own_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """A ROS domain of the test's own, whose nodes write their logs below its folder."""
    from sfr_loc_map.ros import environment
    from sfr_loc_map.ros.domains import hold_domain

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    for name in environment.PROFILE_VARIABLES:
        monkeypatch.setenv(name, str(environment.PROFILE))
    monkeypatch.delenv("ROS_LOCALHOST_ONLY", raising=False)
    with hold_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain.number))
        yield


@pytest.fixture(autouse=True)
def _signals_as_before() -> Iterator[None]:
    """A command handles signals, and at its end ignores them."""
    before = {number: signal.getsignal(number) for number in END_SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def sfr(monkeypatch: pytest.MonkeyPatch) -> Sfr:
    """`sfr(...)` runs a command line in this process. It prints no hints, for tests of what a command itself prints."""
    monkeypatch.delenv("SFR_DEBUG", raising=False)
    monkeypatch.setenv("SFR_HINTS", "0")
    return run_sfr


@pytest.fixture(scope="session")
def scheduler() -> Iterator[str]:
    """Address of a Dask scheduler whose worker is a thread of this process, for suites that do not test workers.

    A suite that starts a worker of its own costs two seconds more.
    """
    distributed = pytest.importorskip("distributed", reason="needs the extra [suite]")
    options = {"threads_per_worker": 1, "processes": False, "protocol": "tcp://", "dashboard_address": ":0"}
    with distributed.LocalCluster(n_workers=1, **options) as cluster:
        yield cluster.scheduler_address


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes() -> None:
    """Let parallel test processes write bytecode; otherwise each, and each process they start, compiles the package.

    `tools/mutants.py` needs the variable, because it changes sources more often than their stamps. It runs no workers.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_collection_finish() -> None:
    """Omit modules and tests, which are never freed, from all later searches for garbage."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that have most slow tests or tests of ROS, so that `make test` ends with short files."""
    markers = ("slow", "ros")
    counts = Counter(item.path for item in items if any(item.get_closest_marker(name) for name in markers))
    items.sort(key=lambda item: -counts[item.path])
