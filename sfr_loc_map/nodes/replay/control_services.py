"""The controls of a replay as services and parameters, named as those of the rosbag2 player."""

from __future__ import annotations

import math
from collections.abc import Callable

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from sfr_loc_map.pipeline.controls import Controls

SEEK, RATE = "seek_s", "rate"
RATE_TEXT = "0: lock step; else multiple of the recorded speed."


def offer_controls(node: Node, controls: Controls) -> None:
    """Offer the controls of a replay.

    Services `~/pause`, `~/resume`, `~/toggle_paused`, `~/is_paused`, `~/play_next`, `~/stop` (std_srvs/Trigger; the
    answer gives the position) and `~/set_loop` (std_srvs/SetBool); parameters `rate` and `seek_s` (continues there).
    """
    actions: dict[str, Callable[[], None]] = {
        "pause": controls.pause,
        "resume": controls.resume,
        "toggle_paused": controls.toggle,
        "is_paused": lambda: None,
        "play_next": controls.step,
        "stop": controls.stop,
    }
    for name, action in actions.items():
        node.create_service(Trigger, f"~/{name}", _serve(controls, name, action))

    def set_loop(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        controls.loop = bool(request.data)
        response.success = True
        return response

    node.create_service(SetBool, "~/set_loop", set_loop)
    _declare(node, controls)


def _serve(controls: Controls, name: str, action: Callable[[], None]) -> Callable[..., Trigger.Response]:
    def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        action()
        response.success = controls.paused if name == "is_paused" else True
        response.message = f"{'paused' if controls.paused else 'playing'} at {controls.position_s:.3f} s"
        return response

    return serve


def _declare(node: Node, controls: Controls) -> None:
    node.declare_parameter(RATE, controls.rate, ParameterDescriptor(description=RATE_TEXT))
    node.declare_parameter(SEEK, 0.0, ParameterDescriptor(description="Set it to continue there. [s]"))

    def check(changes: list[Parameter]) -> SetParametersResult:
        ours = [change.value for change in changes if change.name in (RATE, SEEK)]
        if any(not isinstance(value, float) or not math.isfinite(value) or value < 0 for value in ours):
            return SetParametersResult(successful=False, reason="a number of 0.0 or more is needed")
        if any(change.name == SEEK and change.value > controls.end_s for change in changes):
            reason = f"the last pair is at {controls.end_s:.3f} s: nothing is left after it"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def changed(changes: list[Parameter]) -> None:
        for change in changes:
            if change.name == RATE:
                controls.rate = change.value
            elif change.name == SEEK:
                controls.seek(change.value)

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(changed)
