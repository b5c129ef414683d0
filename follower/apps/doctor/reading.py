"""What can be found out about an installation and its computer, without a vehicle."""

import ctypes
import fcntl
import grp
import logging
import os
import pwd
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path

from packaging.requirements import Requirement
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.apps.doctor.packages import shared_modules, unmet_requirements
from follower.apps.preflight.check import CameraReading, CompanionSnapshot
from follower.apps.preflight.computer_checks import read_computer
from follower.apps.preflight.session import model_states
from follower.links.packet_parser import PacketReader, Unpacker
from follower.links.vehicle_finder import AUTOPILOTS
from follower.settings.settings import Settings
from follower_control.common.transport import UdpTransport
from follower_vision.clock import MonotonicClock
from follower_vision.models import FileState, ModelStore, default_folder
from follower_vision.onnx_network import ModelError, Network
from follower_vision.sources.open import natural_key

GROUPS = ("dialout", "video")
STATION_PORT, VEHICLE_PORT = 14550, 14540
HEARD_S = 1.5
"""Heartbeats come once a second."""
_ROOT = Path("/")
_POLL_S = 0.02
_TRIED = "follower-detector.onnx"
_SERIAL = ("ttyACM*", "ttyUSB*", "ttyAMA*", "ttyTHS*")
_OWN_GOVERNORS = ("intel_pstate", "amd-pstate-epp")
_QUERYCAP, _CAPABILITIES_BYTES, _DEVICE_CAPS_AT, _VIDEO_CAPTURE = 0x80685600, 104, 88, 0x1
_TIMEX_BYTES, _TIME_ERROR = 256, 5
"""struct timex has 208 bytes; adjtimex returns 5 while the clock is not synchronised."""


@dataclass(frozen=True, slots=True)
class DeviceFile:
    """A camera or a serial port.

    Attributes:
        path: under /dev.
        label: what it calls itself, "" if it does not.
        usable: this user may read and write it.
    """

    path: Path
    label: str
    usable: bool

    def __str__(self) -> str:
        return f"{self.path} ({self.label})" if self.label else str(self.path)


@dataclass(frozen=True, slots=True, kw_only=True)
class Installation(CompanionSnapshot):
    """All that is known at one time of an installation and its computer.

    Attributes:
        unmet: requirements of our package that are not met; None if it is not installed.
        shared: packages that install each of the modules that several may.
        device: where networks run.
        refusals: why they do not on the devices that were tried before.
        broken: files of networks that are missing or wrong, and how to get them.
        unfetched: networks that are usual and not there.
        gpu: NVIDIA's device file, None without one.
        cameras: video devices that give frames.
        ports: serial ports.
        consoles: names of those that are the system's console.
        groups: whether this user is in each of the groups that own devices; None is not yet, in
            this login.
        clock_is_set: by a time server; None is unknown.
        governors: of the processor's cores.
        heard: ground stations and vehicles, in words.
    """

    unmet: tuple[Requirement, ...] | None = ()
    shared: Mapping[str, tuple[str, ...]]
    device: str = "cpu"
    refusals: Mapping[str, str]
    broken: Mapping[str, str]
    unfetched: tuple[str, ...] = ()
    gpu: Path | None = None
    cameras: tuple[DeviceFile, ...] = ()
    ports: tuple[DeviceFile, ...] = ()
    consoles: tuple[str, ...] = ()
    groups: Mapping[str, bool | None]
    clock_is_set: bool | None = None
    governors: frozenset[str] = frozenset()
    heard: tuple[str, ...] = ()


def read_installation(settings: Settings, out: Path, lens_given: bool) -> Installation:
    """Find out everything; it takes some seconds.

    Args:
        settings: that would be flown with.
        out: where recordings would go.
        lens_given: the settings name a field of view or a focal length.
    """
    width = settings.camera.focal_width_px
    store = ModelStore(default_folder())
    device, refusals = tried_device(store, settings.vision.device)
    return Installation(
        settings=settings,
        camera=CameraReading(size=settings.camera.frame_size or (width, width * 3 // 4)),
        models=model_states(settings),
        lens_given=lens_given,
        computer=read_computer(out),
        unmet=unmet_requirements(),
        shared=shared_modules(),
        device=device,
        refusals=refusals,
        broken=broken_files(store),
        unfetched=tuple(m.name for m in store.models if m.usual and not store.is_present(m)),
        gpu=next(Path("/dev").glob("nvidia[0-9]*"), None)
        or next(Path("/dev").glob("nvhost-gpu"), None),
        cameras=tuple(cameras()),
        ports=tuple(serial_ports()),
        consoles=tuple(consoles()),
        groups=memberships(GROUPS),
        clock_is_set=clock_is_set(),
        governors=governors(),
        heard=heard((STATION_PORT, VEHICLE_PORT), HEARD_S),
    )


def tried_device(store: ModelStore, device: str) -> tuple[str, Mapping[str, str]]:
    """Return where a network that comes along runs, and why not on the devices before that."""
    logging.disable(logging.WARNING)  # the table says it
    try:
        network = Network(store.file(_TRIED), device)
    except ModelError:  # `broken_files` says so
        return "cpu", {}
    finally:
        logging.disable(logging.NOTSET)
    return network.device, network.refusals


def broken_files(store: ModelStore) -> dict[str, str]:
    """Return what is wrong with networks that are there, and how to get them, by file."""
    there = [model for model in store.models if model.embedded or store.is_present(model)]
    states = {file: state for model in there for file, state in store.verify(model).items()}
    return {
        file: store.advice(file) for file, state in states.items() if state is not FileState.GOOD
    }


def cameras(root: Path = _ROOT) -> Iterator[DeviceFile]:
    """Yield the video devices that give frames, without codecs and what belongs to another."""
    nodes = (root / "sys/class/video4linux").glob("video*")
    for node in sorted(nodes, key=natural_key):
        path = root / "dev" / node.name
        if path.exists() and _text(node / "index") in ("0", "") and _captures(path):
            yield _device_file(path, _text(node / "name"))


def serial_ports(root: Path = _ROOT) -> Iterator[DeviceFile]:
    """Yield the serial ports at which an autopilot may be."""
    links = (root / "dev/serial/by-id").glob("*")
    labels = {link.resolve(): link.name for link in links}
    for pattern in _SERIAL:
        for path in sorted((root / "dev").glob(pattern), key=natural_key):
            yield _device_file(path, labels.get(path.resolve(), ""))


def consoles(root: Path = _ROOT) -> Iterator[str]:
    """Yield the names of the system's consoles, such as "ttyAMA0"."""
    for word in _text(root / "proc/cmdline").split():
        key, _, value = word.partition("=")
        if key == "console":
            yield value.partition(",")[0]


def memberships(names: Sequence[str]) -> dict[str, bool | None]:
    """Return whether this user is in groups, of those that there are; None is not in this login."""
    there: dict[str, bool | None] = {}
    active = {os.getegid(), *os.getgroups()}
    for name in names:
        with suppress(KeyError):  # there is no such group, or this user has no name
            group = grp.getgrnam(name)
            listed = pwd.getpwuid(os.getuid()).pw_name in group.gr_mem
            joined = os.geteuid() == 0 or group.gr_gid in active
            there[name] = True if joined else None if listed else False
    return there


def clock_is_set() -> bool | None:
    """Return whether the kernel says that its clock follows a time server; None is unknown."""
    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (OSError, AttributeError):
        return None
    return None if state < 0 else bool(state != _TIME_ERROR)


def governors(root: Path = _ROOT) -> frozenset[str]:
    """Return how the processor's cores choose their frequency; none where nothing is said."""
    found = set()
    for file in root.glob("sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"):
        name, driver = _text(file), _text(file.with_name("scaling_driver"))
        # These drivers raise the frequency under load with either of their two governors.
        found.add(f"{name} of {driver}" if driver in _OWN_GOVERNORS else name)
    return frozenset(filter(None, found))


def heard(ports: Sequence[int], seconds: float, root: Path = _ROOT) -> tuple[str, ...]:
    """Return which programs listen on UDP ports here, and whose heartbeats come to the others.

    Nothing is sent.
    """
    found: dict[str, None] = {}
    clock, unpacker = MonotonicClock(), Unpacker()
    with ExitStack() as stack:
        listeners: dict[int, tuple[UdpTransport, PacketReader]] = {}
        for port in ports:
            try:
                transport = stack.enter_context(closing(UdpTransport.listen("", port)))
                listeners[port] = transport, PacketReader()
            except OSError:
                found[f"{udp_owner(port, root) or 'a program'} listens on UDP {port}"] = None
        while listeners and clock.now() < seconds:
            for port, (transport, reader) in listeners.items():
                for packet in reader.feed(transport.receive(), clock.now()):
                    if packet.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                        sender = _sender(packet.system, unpacker.message(packet))
                        found[f"{sender} sends heartbeats to UDP {port}"] = None
            clock.sleep_until(clock.now() + _POLL_S)
    return tuple(found)


def udp_owner(port: int, root: Path = _ROOT) -> str:
    """Return the name of the program that listens on a UDP port, "" if that cannot be seen."""
    tables = [_text(root / "proc/net" / name) for name in ("udp", "udp6")]
    rows = [line.split() for table in tables for line in table.splitlines()[1:]]
    sockets = {f"socket:[{row[9]}]" for row in rows if row[1].endswith(f":{port:04X}")}
    for process in (root / "proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended, or is another user's
            if any(str(file.readlink()) in sockets for file in (process / "fd").iterdir()):
                return _text(process / "comm")
    return ""


def _sender(system: int, heartbeat: mavlink.MAVLink_heartbeat_message) -> str:
    if heartbeat.type == mavlink.MAV_TYPE_GCS:
        return f"ground station {system}"
    return f"vehicle {system} ({AUTOPILOTS.get(heartbeat.autopilot, 'another autopilot')})"


def _device_file(path: Path, label: str) -> DeviceFile:
    return DeviceFile(path, label, os.access(path, os.R_OK | os.W_OK))


def _captures(path: Path) -> bool:
    """Return whether a video device gives frames; one that cannot be asked may."""
    try:
        file = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    except OSError:
        return True
    try:
        said = fcntl.ioctl(file, _QUERYCAP, bytes(_CAPABILITIES_BYTES))
    except OSError:
        return True
    finally:
        os.close(file)
    return bool(struct.unpack_from("=I", said, _DEVICE_CAPS_AT)[0] & _VIDEO_CAPTURE)


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace").strip("\0\n ")
    except OSError:
        return ""
