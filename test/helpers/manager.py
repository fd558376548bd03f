"""A peer that manages one node (state, parameters, calls), and the offline result of the localiser."""

from __future__ import annotations

from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_msgs.msg import String

from helpers.made_scene import LOC_RIG, loc_pair
from helpers.node_scenes import calls, problems, send_pair
from helpers.peer import Peer
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.message_types import Level
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.ros.pose_messages import odometry_row
from sfr_loc_map.ros.statuses import level_of, values_of

Capture = pytest.CaptureFixture[str]
Position = tuple[float, ...]


def localised(indices: list[int], **settings: Any) -> list[Position]:
    """Return the positions that the localiser estimates offline."""
    localiser = Localiser(LOC_RIG, LocalisationConfig(**settings), Transform.identity())
    return [tuple(localiser.process(loc_pair(index)).T_ds_rb.translation) for index in indices]


class Manager(Peer):
    """A peer that changes the state and the parameters of one node, and sends it pairs."""

    def __init__(self, node: str = "localisation_node") -> None:
        super().__init__()
        self.name = node
        self.diagnostics = self.listen(DiagnosticArray, "/diagnostics")
        self.calls = self.listen(String, f"{node}/call")
        self.clients: dict[str, Any] = {}
        self.odometry = self.listen(Odometry, "localisation/odometry")

    def ask(self, kind: type[Any], service: str, request: Any) -> Any:
        if (full := f"{self.name}/{service}") not in self.clients:
            self.clients[full] = self.node.create_client(kind, full)
        return self.answer(self.clients[full], request, again=kind is not ChangeState)

    def change(self, transition: int) -> tuple[bool, str]:
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.ask(ChangeState, "change_state", request).success, self.state()

    def state(self) -> str:
        return str(self.ask(GetState, "get_state", GetState.Request()).current_state.label)

    def set(self, **values: float | int) -> str:
        """Set parameters, with `__` for a dot; return the reason of a refusal, or an empty text."""
        parameters = [Parameter(name.replace("__", "."), value=v).to_parameter_msg() for name, v in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        result = self.ask(SetParametersAtomically, "set_parameters_atomically", request).result
        return "" if result.successful else str(result.reason)

    def play(self, index: int, shift_ns: int = 0) -> Position:
        """Send a pair, wait for its odometry and for the diagnostics of its call, and return the position."""
        count, pair = len(self.odometry), loc_pair(index)
        stamp_ns = pair.stamp_ns + shift_ns
        send_pair(self, "loc", StereoPair(stamp_ns, pair.left, pair.right))
        self.until(lambda: len(self.odometry) > count and self.last_call() == stamp_ns, "odometry and call")
        return self.positions()[-1]

    def positions(self) -> list[Position]:
        return [odometry_row(message)[1] for message in self.odometry]

    def last_values(self) -> dict[str, str]:
        """Return the values of the last call."""
        return values_of(calls(self.diagnostics)[-1])

    def last_call(self) -> int:
        """Return the stamp of the last call, -1 before the first."""
        return int(self.last_values()["stamp_ns"]) if calls(self.diagnostics) else -1

    def refused(self, words: str) -> None:
        """Wait until the node reports a problem with these words."""
        self.until(lambda: words in problems(self.diagnostics), f"'{words}'")

    def health(self) -> list[DiagnosticStatus]:
        return [s for array in self.diagnostics for s in array.status if s.name == f"{self.name}: health"]

    def well(self, level: Level, words: str = "") -> DiagnosticStatus:
        """Wait for a health status of this level whose message contains the words."""

        def found() -> DiagnosticStatus | None:
            last = self.health()[-1:]
            return last[0] if last and level_of(last[0]) is level and words in last[0].message else None

        return self.until(found, f"health {level.name} '{words}'")


class LocalNode:
    """A node in the process of the test, spun together with the peer; its log is captured."""

    def __init__(self, peer: Peer, capture: Capture, kind: type[ManagedNode[Any]], *arguments: str) -> None:
        self._peer, self._capture, self._text = peer, capture, ""
        self.node = kind(cli_args=["--ros-args", *arguments], use_global_arguments=False)
        peer.executor.add_node(self.node)
        self.node.start()

    def __enter__(self) -> LocalNode:
        return self

    def __exit__(self, *_: object) -> None:
        self._peer.executor.remove_node(self.node)
        self.node.destroy_node()

    @property
    def text(self) -> str:
        captured = self._capture.readouterr()
        self._text += captured.out + captured.err
        return self._text

    def wait_for(self, words: str) -> None:
        self._peer.until(lambda: words in self.text, f"'{words}' in the log")
