"""MAVProxy module for the drone target follower: choose its target, release it, see what it does.

Copy it to where MAVProxy's modules are, then in MAVProxy `module load follower`:

    cp mavproxy_follower.py "$(python3 -c 'import MAVProxy.modules as m; print(m.__path__[0])')"

The follower needs `ground_station.enabled=true`. It speaks MAVLink's camera protocol: nothing here
is a message of its own, and nothing of the follower is imported.
"""

import time
from typing import Any

from MAVProxy.modules.lib import mp_module
from pymavlink import mavutil

_MAVLINK = mavutil.mavlink
_EVERY_US = 200_000
_OLD_S = 2.0
_USAGE = """follower select X Y               the object at a point, as shares of the image, 0 to 1
follower select LEFT TOP RIGHT BOTTOM   what a box shows, likewise
follower release                  drop the target: the vehicle holds and is released
follower status                   the target's box and state
follower camera NUMBER            its camera component, 100 unless set otherwise"""
_STATES = {0: "no target", 1: "tracking", 2: "lost", 9: "coasting"}
"""By CAMERA_TRACKING_STATUS_FLAGS."""
_RESULTS = {0: "accepted", 2: "denied", 3: "unsupported", 4: "failed"}


class FollowerModule(mp_module.MPModule):
    """Speaks to the follower's camera on the vehicle's system."""

    def __init__(self, mpstate: Any) -> None:
        super().__init__(mpstate, "follower", "drone target follower", public=True)
        self._camera = _MAVLINK.MAV_COMP_ID_CAMERA
        self._status: Any = None
        self._said = ""
        commands = ["select", "release", "status", "camera"]
        self.add_command("follower", self._run, "drone target follower", commands)
        self._ask_for_status()

    def mavlink_packet(self, message: Any) -> None:
        """Take what the follower's camera says."""
        ours = message.get_srcSystem(), message.get_srcComponent()
        if ours != (self.target_system, self._camera):
            return
        kind = message.get_type()
        if kind == "CAMERA_TRACKING_IMAGE_STATUS":
            self._status = message
        elif kind == "STATUSTEXT":
            self._said = message.text
        elif kind == "COMMAND_ACK" and message.command in (
            _MAVLINK.MAV_CMD_CAMERA_TRACK_POINT,
            _MAVLINK.MAV_CMD_CAMERA_TRACK_RECTANGLE,
            _MAVLINK.MAV_CMD_CAMERA_STOP_TRACKING,
        ):
            print(f"follower: {_RESULTS.get(message.result, message.result)}")

    def _run(self, words: list[str]) -> None:
        try:
            numbers = [float(word) for word in words[1:]]
        except ValueError:
            numbers = [float("nan")]
        match (words[0] if words else "", len(numbers)):
            case ("select", 2) if all(0 <= one <= 1 for one in numbers):
                self._send(_MAVLINK.MAV_CMD_CAMERA_TRACK_POINT, *numbers)
            case ("select", 4) if all(0 <= one <= 1 for one in numbers):
                self._send(_MAVLINK.MAV_CMD_CAMERA_TRACK_RECTANGLE, *numbers)
            case ("release", 0):
                self._send(_MAVLINK.MAV_CMD_CAMERA_STOP_TRACKING)
            case ("status", 0):
                print(self._described())
                self._ask_for_status()
            case ("camera", 1) if 1 <= numbers[0] <= 255:
                self._camera, self._status = int(numbers[0]), None
                self._ask_for_status()
            case _:
                print(_USAGE)

    def _described(self) -> str:
        status = self._status
        if status is None or time.time() - status._timestamp > _OLD_S:
            return f"follower: nothing heard from camera {self._camera} of {self.target_system}"
        state = _STATES.get(status.tracking_status, str(status.tracking_status))
        text = f"follower: {state}"
        if status.tracking_status:
            left, top = status.rec_top_x, status.rec_top_y
            right, bottom = status.rec_bottom_x, status.rec_bottom_y
            text += f", box {left:.3f} {top:.3f} {right:.3f} {bottom:.3f}"
        return f"{text}; it said: {self._said}" if self._said else text

    def _ask_for_status(self) -> None:
        number = _MAVLINK.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS
        self._send(_MAVLINK.MAV_CMD_SET_MESSAGE_INTERVAL, number, _EVERY_US)

    def _send(self, command: int, *numbers: float) -> None:
        padded = (*numbers, *[0.0] * (7 - len(numbers)))
        self.master.mav.command_long_send(self.target_system, self._camera, command, 0, *padded)


def init(mpstate: Any) -> FollowerModule:
    """Return the module; MAVProxy calls this."""
    return FollowerModule(mpstate)
