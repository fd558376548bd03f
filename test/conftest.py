"""What all tests share."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from helpers.cli_result import Result, Sfr
from sfr_loc_map.signals import END_SIGNALS

os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")  # before any message class is imported

# What an example costs by the clock, on a busy host, says nothing of the code.
hypothesis.settings.register_profile(
    "busy_host", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("busy_host")

# A shell that runs the tests in its background has them, and what they start, ignore Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the development data; the test is skipped where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("the development data is not beside this checkout")
    return SHARED


@pytest.fixture
def own_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A ROS domain of the test's own, whose nodes write their logs below its folder."""
    from helpers.ros_domain import free_domain
    from sfr_loc_map.nodes.ros import environment

    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    for name in environment.PROFILE_VARIABLES:
        monkeypatch.setenv(name, str(environment.PROFILE))
    monkeypatch.delenv("ROS_LOCALHOST_ONLY", raising=False)


@pytest.fixture(autouse=True)
def _signals_as_before() -> Iterator[None]:
    """A command handles signals, and at its end ignores them."""
    before = {number: signal.getsignal(number) for number in END_SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def sfr(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Sfr:
    """`sfr(...)` as from the shell, without the cost of a process for each."""
    from sfr_loc_map.cli.main import main

    monkeypatch.delenv("SFR_DEBUG", raising=False)
    monkeypatch.setenv("SFR_HINTS", "0")  # for tests of what a command says itself

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["sfr", *map(str, arguments)])
        capsys.readouterr()
        code = main()
        return Result(code, *capsys.readouterr())

    return run


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a Dask scheduler whose worker is a thread of this process, for suites whose workers are no subject.

    A suite that starts a worker of its own costs two seconds more.
    """
    distributed = pytest.importorskip("distributed", reason="needs the extra [suite]")
    options = {"threads_per_worker": 1, "processes": False, "protocol": "tcp://", "dashboard_address": ":0"}
    with distributed.LocalCluster(n_workers=1, **options) as cluster:
        yield cluster.scheduler_address


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that have slow tests: at the end all processes of `make test` have short ones left."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
