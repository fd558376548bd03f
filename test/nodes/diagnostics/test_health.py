# ruff: noqa: E402 - ROS may be absent
import pytest

pytest.importorskip("rclpy")  # levels are those of a message
pytestmark = pytest.mark.ros

from sfr_loc_map.nodes.diagnostics.health import Health, HealthConfig, HealthStatus, NodeActivity
from sfr_loc_map.nodes.diagnostics.key_values import Level


class Node:
    def __init__(self, **settings: float) -> None:
        self.now = 100.0
        self.health = Health(HealthConfig(**settings), lambda: self.now)
        self.counts = {"dropped_stale": 0}

    def judge(self, *, expecting: bool = True, lifecycle: str = "active") -> HealthStatus:
        return self.health.judge(NodeActivity(lifecycle, self.counts, 0, expecting))

    def call(self, level: Level = Level.OK, state: str = "tracking", **statistics: float) -> None:
        self.health.note_arrival()
        self.health.note_call(level, state, {"processing_time_s": 0.1, "latency_transport_s": 0.002}, statistics)


def test_a_node_that_works_is_well_and_gives_its_figures() -> None:
    node = Node()
    for _ in range(20):
        node.now += 0.1
        node.call()
    verdict = node.judge()
    assert (verdict.level, verdict.message) == (Level.OK, "tracking")
    assert verdict.values["processed_hz"] == pytest.approx(10.0)
    assert verdict.values["last_processing_time_s"] == 0.1
    assert verdict.values["latency_transport_p95_s"] == 0.002
    assert verdict.values["dropped_stale"] == 0


def test_silence_is_stale_only_where_something_is_due() -> None:
    node = Node(stale_after_s=2.0)
    node.call()
    node.now += 2.1
    assert node.judge().level is Level.STALE
    assert node.judge(expecting=False).level is Level.OK
    assert node.judge(lifecycle="inactive").level is Level.OK
    node.health.note_arrival()
    assert node.judge().level is Level.OK


def test_drops_and_problems_show_for_the_window() -> None:
    node = Node(window_s=3.0)
    node.call()
    node.counts["dropped_stale"] = 1
    assert (node.judge().level, node.judge().message) == (Level.WARN, "dropped_stale")
    node.health.note_problem(Level.ERROR, "no camera_info")
    assert node.judge().message == "no camera_info; dropped_stale"
    assert node.judge().level is Level.ERROR
    node.now += 3.1
    assert node.judge().level is Level.OK
    for share in (25, 40):
        node.health.note_problem(Level.WARN, f"{share}% are lost", "transport")
    assert node.judge().message == "40% are lost"


@pytest.mark.parametrize(("rows", "level"), [(0.29, Level.OK), (0.31, Level.WARN), (-0.31, Level.WARN)])
def test_a_calibration_that_is_off_is_warned_of(rows: float, level: Level) -> None:
    node = Node()
    node.call(vertical_offset_px=rows)
    node.call()  # a call that does not say keeps what was known
    assert node.judge().level is level


def test_lost_is_an_error_and_much_memory_a_warning() -> None:
    node = Node(memory_warn_mb=1)
    node.call()
    assert (node.judge().level, "more than 1 MB" in node.judge().message) == (Level.WARN, True)
    node.call(Level.ERROR, "lost")
    assert node.judge().level is Level.ERROR


def test_an_error_says_more_than_silence() -> None:
    node = Node(stale_after_s=1.0, window_s=60.0)
    node.health.note_problem(Level.ERROR, "camera_info is not rectified")
    node.now += 2.0
    verdict = node.judge()
    assert verdict.level is Level.ERROR
    assert verdict.message == "camera_info is not rectified; nothing came for more than 1 s"


def test_what_was_before_is_forgotten_when_the_health_is_reset() -> None:
    node = Node()
    node.call(Level.ERROR, "lost")
    node.health.reset()
    assert node.judge().level is Level.OK


def test_many_problems_are_counted_not_listed_and_are_one_change() -> None:
    node = Node()
    node.call()
    well = node.judge()
    node.health.note_problem(Level.ERROR, "pair 0 is broken")
    ill = node.judge()
    assert ill.kind != well.kind
    for number in range(1, 10):
        node.health.note_problem(Level.ERROR, f"pair {number} is broken")
    verdict = node.judge()
    assert verdict.kind == ill.kind
    listed = "; ".join(f"pair {number} is broken" for number in (9, 8, 7, 6))
    assert verdict.message == f"{listed}; and 6 more"


@pytest.mark.parametrize("name", ["vertical_offset_px", "roll_offset_px", "disparity_offset_px"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_calibration_that_is_off_is_warned_of_beyond_its_limit(name: str, sign: float) -> None:
    node = Node(**{name.replace("_px", "_warn_px"): 0.2})
    node.call(**{name: sign * 0.19})
    assert node.judge().level is Level.OK
    node.call(**{name: sign * 0.21})
    verdict = node.judge()
    assert verdict.level is Level.WARN
    assert "0.2" in verdict.message
    assert "check the calibration" in verdict.message
    assert verdict.values[name] == sign * 0.21
    node.call()  # a call without the figure (lost) does not take it back
    assert node.judge().level is Level.WARN
