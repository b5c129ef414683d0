"""The lifecycle node: configure, activate and deactivate are a flight's beginning and end."""

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, RegionOfInterest
from std_srvs.srv import Trigger

from follower.apps.ros.conversion import flat_settings, lens_of
from follower.apps.ros.detections import TopicDetector, box_of
from follower.apps.ros.io_node import RELIABLE, IoNode
from follower.apps.ros.outputs import Outputs
from follower.apps.ros.session import PERCEPTION_SKIPS, TopicEnds, TopicPursuit
from follower.apps.ros.topic_source import TopicSource
from follower.apps.ros.vehicle_topics import MavrosTopics, VehicleTopics
from follower.settings.field_docs import setting_meaning
from follower.settings.live import live_keys
from follower.settings.settings import Settings, load_settings
from follower.ui.terminal.cli_options import parse_box
from follower.ui.terminal.interrupt import StopOnInterrupt, stop_signals
from follower_control.common.strict_config import SettingsError
from follower_control.servo.settings import FollowMode
from follower_vision.geometry.box import Box
from follower_vision.mailbox import Mailbox

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
MODES = ("perception", "mavros", "direct")
_BY = "ROS"
_WAIT_S = 5.0
"""For the lens and /clock, which come on another thread."""
_CONFIGURED = ("mode", "mavros", "detections", "config", "use_sim_time")
"""Parameters by which the topics are opened: the transport is made with them."""
_SHOWN = 3
"""So many lines of why it cannot begin are in the diagnostics."""
_LENS = ("camera.focal_px", "camera.fov_deg")
_DEFAULTS = flat_settings(Settings())


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """What the node begins with; each is a parameter, too.

    Attributes:
        mode: "perception" (others fly), "mavros" (setpoints through MAVROS) or "direct" (MAVLink).
        target: "car", "#rrggbb" or "x,y,w,h"; "" leaves it to topics and services.
        connect: where the autopilot speaks MAVLink, in mode direct.
        mavros: MAVROS' namespace.
        image_transport: "raw" or "compressed".
        out: folder of the recordings.
        skip_preflight: names of checks that do not refuse.
        config: settings file, "" for none.
        detections: topic of another node's detections, "" for none.
    """

    mode: str = "perception"
    target: str = ""
    connect: str = "udpin:0.0.0.0:14540"
    mavros: str = "mavros"
    image_transport: str = "raw"
    out: str = "runs"
    skip_preflight: str = ""
    config: str = ""
    detections: str = ""


class FollowerNode(LifecycleNode):
    """Follows a target seen in a topic of images; see examples/follower-ros/README.md.

    Configure reads the parameters and listens; activate does the preflight checks, which may
    refuse it, and begins the flight; deactivate brakes, holds and releases the vehicle before it
    answers. Consent stays the pilot's: nothing here arms, takes off, changes the mode or consents.

    Args:
        options: first values of the parameters.
        settings: likewise, of all settings.
    """

    def __init__(self, options: NodeOptions, settings: Settings) -> None:
        super().__init__("follower")
        self._base, self._read = flat_settings(settings), options.config
        for name in NodeOptions.__dataclass_fields__:
            self.declare_parameter(name, getattr(options, name))
        for key, value in self._base.items():
            meaning = setting_meaning(settings, key)
            described = ParameterDescriptor(description=meaning, dynamic_typing=True)
            self.declare_parameter(key, value, described)
        self._live = {one.key for one in live_keys()}
        self._io: IoNode | None = None
        self._info: Mailbox[Any] = Mailbox()
        self._vehicle: VehicleTopics | None = None
        self._detector: TopicDetector | None = None
        self._pursuit: TopicPursuit | None = None
        self._source: TopicSource | None = None
        self._failure = ""
        self._outputs = Outputs(self)
        self.add_on_set_parameters_callback(self._on_parameters)
        self.create_service(Trigger, "~/select", self._on_select)
        self.create_service(Trigger, "~/release", self._on_release)
        for mode in FollowMode:
            follows = partial(self._on_follow_mode, mode)
            self.create_service(Trigger, f"~/follow_mode/{mode}", follows)
        # Of the computer's time: a /clock that stands has to be told of, too.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.5, self._diagnose, clock=steady)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, open the topics that are taken in; nothing can move yet."""
        return self._tried("configure", self._configure) or super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check, and begin the flight."""
        return self._tried("activate", self._activate) or super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake, hold, release the vehicle, end the flight."""
        self.end_flight()
        return super().on_deactivate(state)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Take nothing in any more."""
        self._close_io()
        return SUCCESS

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """End the flight, if there is one, and take nothing in any more."""
        self.end_flight()
        self._close_io()
        return SUCCESS

    def close(self) -> None:
        """End whatever goes on, in order, and destroy the node."""
        self.end_flight()
        self._close_io()
        self._outputs.close()
        self.destroy_node()

    def end_flight(self) -> None:
        """Brake, hold, release, close; returns once that is done."""
        pursuit, self._pursuit, self._source = self._pursuit, None, None
        if pursuit is not None:
            try:
                pursuit.__exit__(None, None, None)
            except Exception as error:  # the vehicle is released; a node must live on to say so
                self._failure = f"the flight failed: {error}"
                self.get_logger().error(self._failure)
            self.get_logger().info(f"{pursuit.end.sentence}; recorded in {pursuit.folder}")

    def _tried(self, what: str, do: Callable[[], None]) -> TransitionCallbackReturn | None:
        try:
            do()
        except (ValueError, OSError, ImportError) as error:
            lines = [" ".join(one.split()) for one in str(error).splitlines()] or [repr(error)]
            more = [f"and {len(lines) - _SHOWN} more, see the log"] if len(lines) > _SHOWN else []
            self._failure = f"cannot {what}: {'; '.join([*lines[:_SHOWN], *more])}"
            self.get_logger().error("\n  ".join([f"cannot {what}: {lines[0]}", *lines[1:]]))
            return FAILURE
        self._failure = ""
        return None

    def _value(self, name: str) -> Any:
        value = self.get_parameter(name).value
        return value.tolist() if isinstance(value, array) else value

    def _configure(self) -> None:
        mode = self._value("mode")
        if mode not in MODES:
            raise SettingsError(f"mode {mode!r}: choose one of {', '.join(MODES)}")
        if self._value("image_transport") not in ("raw", "compressed"):
            raise SettingsError("image_transport: raw or compressed")
        unknown = [one for one in self._parameter_overrides if not self.has_parameter(one)]
        if unknown:
            said = ", ".join(sorted(unknown))
            raise SettingsError(f"no parameters of this node: {said}; `ros2 param list` names them")
        self._read_config()
        self._io = io = IoNode(f"{self.get_name()}_io", self)
        try:
            io.subscribe(CameraInfo, "camera_info", self._info.put)
            io.subscribe(RegionOfInterest, "target_roi", self._take_region, RELIABLE)
            self._subscribe_detections(io)
            if mode != "direct":
                prefix = self._value("mavros")
                self._vehicle = MavrosTopics(io, prefix) if mode == "mavros" else VehicleTopics(io)
            io.start()
        except BaseException:
            self._close_io()
            raise

    def _read_config(self) -> None:
        """Let the parameters be what the file of `config` says, where nobody has set them."""
        config = self._value("config")
        if config == self._read:
            return
        base = flat_settings(load_settings(config or None))
        untouched = [key for key in base if self._value(key) == self._base.get(key)]
        self.set_parameters([Parameter(key, value=base[key]) for key in untouched])
        self._base, self._read = base, config

    def _subscribe_detections(self, io: IoNode) -> None:
        detections = self._value("detections")
        if detections:
            self._detector = TopicDetector(io, detections)
        try:
            from vision_msgs.msg import Detection2D
        except ImportError:
            return
        io.subscribe(Detection2D, "target_detection", self._take_detection, RELIABLE)

    def _activate(self) -> None:
        io, vehicle = self._io, self._vehicle
        if io is None:
            raise SettingsError("configure first")
        if not io.clock.ticks(_WAIT_S):
            raise SettingsError("use_sim_time is set, and /clock does not tick")
        self._source = source = TopicSource(self, "image", self._value("image_transport"), io.clock)
        outputs, mode, target = self._outputs, self._value("mode"), self._value("target")
        outputs.clock, outputs.image_frame, outputs.vehicle = io.clock, "camera", vehicle
        ends = TopicEnds(source, io.clock, vehicle, self._detector, outputs.show, outputs)
        steers = mode != "perception"
        skips = [*self._value("skip_preflight").split(), *(() if steers else PERCEPTION_SKIPS)]
        try:
            pursuit = TopicPursuit(
                ends,
                self._value("connect") if mode == "direct" else f"ros:{mode}",
                f"ros:{self.resolve_topic_name('image')}",
                steers=steers,
                target=self._target(target) if target else None,
                config=self._value("config") or None,
                overrides=self._overrides(),
                skip_preflight=skips,
                out=self._value("out"),
            )
            outputs.settings = pursuit.settings
            pursuit.__enter__()
        except BaseException:
            source.close()
            raise
        outputs.image_frame = source.frame_id or "camera"
        self._pursuit = pursuit

    def _overrides(self) -> list[str]:
        """Return the settings that are not as they began, and the lens of CameraInfo."""
        given = {
            key: self._value(key)
            for key in self._base
            if not self._value(key) == self._base[key] == _DEFAULTS[key]
        }
        lens: dict[str, Any] = {}
        if not any(key in given for key in _LENS):
            info = self._info.newest or self._info.wait(_WAIT_S)
            lens = {} if info is None else lens_of(info)
            if info is not None and not lens:
                said = "camera_info is left out: not calibrated, not finite, or no lens of ours"
                self.get_logger().warning(said)
        named = {f"camera.{key}": np.asarray(value).tolist() for key, value in lens.items()}
        return [f"{key}={value}" for key, value in {**named, **given}.items()]

    def _take_region(self, m: RegionOfInterest) -> None:
        if m.width and m.height:
            self._select_box(Box.from_xywh(m.x_offset, m.y_offset, m.width, m.height))

    def _take_detection(self, message: Any) -> None:
        self._select_box(box_of(message))

    def _select_box(self, box: Box) -> None:
        pursuit = self._pursuit  # the flight may end meanwhile
        try:
            if pursuit is not None:
                pursuit.select(box)
        except ValueError as error:
            self.get_logger().warning(f"no target: {error}")

    def _on_select(self, _request: Any, answer: Any) -> Any:
        """Choose what the parameter `target` names, anew."""
        answer.success, answer.message = self._answered(lambda: self._select(self._value("target")))
        return answer

    def _on_release(self, _request: Any, answer: Any) -> Any:
        answer.success, answer.message = self._answered(
            lambda: self._flying().flight.requests.stop(_BY)
        )
        return answer

    def _on_follow_mode(self, mode: str, _request: Any, answer: Any) -> Any:
        """Set the parameter `servo.mode`."""
        result = self.set_parameters([Parameter("servo.mode", value=mode)])[0]
        answer.success, answer.message = result.successful, result.reason
        return answer

    def _flying(self) -> TopicPursuit:
        if self._pursuit is None:
            raise SettingsError("the node is not active")
        return self._pursuit

    def _select(self, target: str) -> None:
        self._flying().select(self._target(target))

    def _target(self, text: str) -> Box | str:
        target = parse_target(text)
        if self._detector is not None and isinstance(target, str) and not target.startswith("#"):
            self._detector.know(target.partition(":")[0])
        return target

    def _answered(self, do: Callable[[], None]) -> tuple[bool, str]:
        try:
            do()
        except ValueError as error:
            return False, " ".join(str(error).split())
        return True, ""

    def _on_parameters(self, parameters: list[Any]) -> SetParametersResult:
        """Change settings in flight where they may be, and select a new target."""
        gone = [one.name for one in parameters if one.type_ is Parameter.Type.NOT_SET]
        if gone:
            said = f"{', '.join(gone)}: cannot be deleted; set a value, 'null' for none"
            return SetParametersResult(successful=False, reason=said)
        if self._pursuit is None:
            late = [one.name for one in parameters if one.name in _CONFIGURED]
            if self._io is None or not late:
                return SetParametersResult(successful=True)
            said = f"{', '.join(late)}: not once configured; clean up first"
            return SetParametersResult(successful=False, reason=said)
        holds = flat_settings(self._pursuit.flight.requests.settings)
        live = {
            one.name: one.value
            for one in parameters
            if one.name in self._live and one.value != holds[one.name]
        }
        others = [p.name for p in parameters if p.name not in (*self._live, "target")]
        if others:
            said = f"{', '.join(others)}: not while active; deactivate first"
            return SetParametersResult(successful=False, reason=said)

        def change() -> None:
            for one in parameters:
                if one.name == "target":
                    self._select(one.value)
            if live:
                values = {key: None if one == "null" else one for key, one in live.items()}
                changed = self._flying().flight.requests.change_all(values, _BY)
                self._outputs.settings = changed

        good, said = self._answered(change)
        return SetParametersResult(successful=good, reason=said)

    def _diagnose(self) -> None:
        pursuit, problem = self._pursuit, self._failure
        status = None
        if pursuit is not None:
            if not pursuit.flying:
                problem = problem or "the flight has ended by itself: deactivate, see the log"
            status = pursuit.status
            self._mirror(pursuit.flight.requests.settings)
            problem = problem or (self._source.problem if self._source else None) or ""
        self._outputs.diagnose(status, problem, self._value("mode"))

    def _mirror(self, settings: Settings) -> None:
        """Let the parameters be what others, such as a ground station, have changed in flight."""
        if settings is self._outputs.settings:
            return
        self._outputs.settings = settings
        now = flat_settings(settings)
        other = [key for key in self._live if self._value(key) != now[key]]
        self.set_parameters([Parameter(key, value=now[key]) for key in other])

    def _close_io(self) -> None:
        if self._io is not None:
            self._io.close()
        self._io = self._vehicle = self._detector = None
        self._info = Mailbox()


def parse_target(text: str) -> Box | str:
    """Return a target as `Pursuit` takes it: "x,y,w,h" is a box.

    Raises:
        SettingsError: the text is no target.
    """
    if text.count(",") == 3:
        return parse_box(text)
    if not text.strip():
        raise SettingsError("which target? set the parameter target to a class, #rrggbb or x,y,w,h")
    return text


def run_node(
    options: NodeOptions, settings: Settings, ros_args: list[str], *, activate: bool = False
) -> int:
    """Be the node until Ctrl-C or a polite kill, which end a flight in order; return an exit code.

    Args:
        options: first values of the node's own parameters.
        settings: likewise of all settings.
        ros_args: as `--ros-args` takes them.
        activate: configure and activate at once.

    Raises:
        SettingsError: ROS does not take its arguments or a parameter's type.
    """
    node, code = _begun(options, settings, ros_args), 0
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        with stop_signals():
            if activate:
                good = node.trigger_configure() is SUCCESS and node.trigger_activate() is SUCCESS
                code = 0 if good else 1
            while code == 0:
                executor.spin_once(timeout_sec=0.1)
    except KeyboardInterrupt:
        pass
    finally:
        with StopOnInterrupt():
            node.close()
            rclpy.shutdown()
    return code


def _begun(options: NodeOptions, settings: Settings, ros_args: list[str]) -> FollowerNode:
    try:
        # ROS's own handlers would close the way by which the vehicle is released.
        rclpy.init(args=["follower", *ros_args], signal_handler_options=SignalHandlerOptions.NO)
        return FollowerNode(options, settings)
    except (RuntimeError, ParameterException) as error:
        rclpy.try_shutdown()
        said = " ".join(str(error).split())
        raise SettingsError(f"ROS does not begin, see what follows --ros-args: {said}") from error
