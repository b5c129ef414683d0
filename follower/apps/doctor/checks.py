"""All checks of `follower doctor`; each is a small function of what was found out."""

import platform
import shlex
import sys
from collections.abc import Sequence

from follower.apps.doctor.packages import (
    installing,
    pip,
    reinstalling,
    versions_of,
)
from follower.apps.doctor.reading import STATION_PORT, DeviceFile, Installation
from follower.apps.preflight.camera_checks import CAMERA
from follower.apps.preflight.check import (
    CheckGroup,
    PreflightCheck,
    PreflightFinding,
    PreflightResult,
    failed,
    passed,
    unknown,
    warned,
)
from follower.apps.preflight.computer_checks import COMPUTER
from follower.links.connections import permission_advice
from follower.links.signing import SigningKey, SigningKeyError
from follower_vision.onnx_network import AUTO

SOFTWARE = CheckGroup[Installation]("Software")
DEVICES = CheckGroup[Installation]("Devices")
SYSTEM = CheckGroup[Installation]("System")
_RAW_CAMERAS = ("rp1-cfe", "unicam", "vi-output")
"""What the receivers of CSI cameras on Raspberry Pi and Jetson call themselves."""
_SLOW_GOVERNORS = frozenset({"powersave", "conservative"})
_OF_SETTINGS = ("models", "lens", "mount")
"""Checks of the camera's table that need no frame."""


@SOFTWARE.check("python", "64 bit: for others there is no onnxruntime")
def _python(_: Installation) -> PreflightFinding:
    text = f"Python {platform.python_version()}, {platform.machine()}, in {sys.prefix}"
    if sys.maxsize < 2**32:
        return failed(f"{text}: 32 bit", "install a 64 bit system")
    return passed(text)


@SOFTWARE.check("packages", "what this program asks for is installed, in versions that fit")
def _packages(s: Installation) -> PreflightFinding:
    if s.unmet is None:
        return warned("run from its sources: nothing says what it asks for", pip("install", "."))
    if s.unmet:
        listed = ", ".join(f"{one.name}{one.specifier}" for one in s.unmet)
        return failed(f"missing, or of another version: {listed}", installing(s.unmet))
    return passed(versions_of(s.shared))


@SOFTWARE.check(
    "one-of-each",
    "one package installs onnxruntime, and one OpenCV: of two, the one installed last lies over "
    "the other",
)
def _one_of_each(s: Installation) -> PreflightFinding:
    several = {module: names for module, names in s.shared.items() if len(names) > 1}
    if several:
        return failed(
            "; ".join(
                f"{' and '.join(names)} shadow one another: each installs the module {module}"
                for module, names in several.items()
            ),
            " && ".join(reinstalling(module, names) for module, names in several.items()),
        )
    return passed(", ".join(name for names in s.shared.values() for name in names))


@SOFTWARE.check("accelerator", "networks run where vision.device says", needed=False)
def _accelerator(s: Installation) -> PreflightFinding:
    wanted = s.settings.vision.device
    text = f"networks run on {s.device}"
    text += "".join(f"; not on {name}: {why}" for name, why in s.refusals.items())
    if s.refusals and (wanted != AUTO or s.gpu):
        return warned(text, "its package, driver and libraries: docs/reference/trackers.md")
    if s.gpu and wanted == AUTO and s.device == "cpu":
        cure = reinstalling("onnxruntime", ("onnxruntime", "onnxruntime-gpu"))
        return warned(
            f"{text}, although there is {s.gpu}",
            f"{cure} (on a Jetson: the wheel made for its JetPack)",
        )
    return passed(text)


@SOFTWARE.check("networks", "those that come along or were fetched have the right SHA-256")
def _networks(s: Installation) -> PreflightFinding:
    if s.broken:
        return failed(
            f"missing or damaged: {', '.join(s.broken)}",
            "; ".join(dict.fromkeys(s.broken.values())),
        )
    if s.unfetched:
        return warned(f"not here: {', '.join(s.unfetched)}", "follower models pull")
    return passed("all are intact")


@DEVICES.check("cameras", "a camera is there that this user may use")
def _cameras(s: Installation) -> PreflightFinding:
    usable = [one for one in s.cameras if one.usable]
    if any(not one.label.startswith(_RAW_CAMERAS) for one in usable):
        return passed(_listed(usable))
    if usable:
        todo = "give it as a stream (docs/tutorials/raspberry-pi.md)"
        return warned(f"{_listed(usable)}: a CSI camera's raw data", todo)
    if s.cameras:
        return failed(f"no permission: {_listed(s.cameras)}", _permission(s.cameras))
    return warned("none under /dev/video*", "plug it in; a stream (rtsp, udp) needs none")


@DEVICES.check("serial-ports", "a port is there that this user may use")
def _serial_ports(s: Installation) -> PreflightFinding:
    taken = [one for one in s.ports if one.path.name in s.consoles]
    free = [one for one in s.ports if one not in taken]
    if any(one.usable for one in free):
        return passed(_listed([one for one in free if one.usable]))
    if free:
        return failed(f"no permission: {_listed(free)}", _permission(free))
    if taken:
        todo = "sudo raspi-config: Interface Options, Serial Port, login shell no, hardware yes"
        return warned(f"{_listed(taken)} is the system's console", todo)
    todo = "plug it in; Raspberry Pi 5: dtparam=uart0=on; UDP and TCP need none"
    return warned("none", todo)


@DEVICES.check("groups", "this user is in dialout and video, as far as there are such groups")
def _groups(s: Installation) -> PreflightFinding:
    outside = [name for name, joined in s.groups.items() if joined is False]
    if outside:
        todo = f"sudo usermod -aG {','.join(outside)} $USER, then log in again"
        return warned(f"not in {', '.join(outside)}", todo)
    waiting = [name for name, joined in s.groups.items() if joined is None]
    if waiting:
        return warned(f"in {', '.join(waiting)}, but not in this login", "log in again")
    return passed(", ".join(s.groups) or "this system has neither")


@DEVICES.check("signing-key", "the file of link.signing_key_file can be read, by its owner alone")
def _signing_key(s: Installation) -> PreflightFinding:
    file = s.settings.link.signing_key_file
    if file is None:
        return passed("none: the link is not signed")
    try:
        SigningKey.from_file(file)
    except SigningKeyError as error:
        return failed(str(error), f"see link.signing_key_file; chmod 600 {shlex.quote(file)}")
    return passed(file)


@DEVICES.check(
    "ground-station",
    "a program listens on UDP 14550 here, or heartbeats come to UDP 14550 or 14540",
    needed=False,
)
def _ground_station(s: Installation) -> PreflightFinding:
    if s.heard:
        return passed("; ".join(s.heard))
    return unknown(
        f"nothing listens on UDP {STATION_PORT} and no heartbeat came; what is behind a serial "
        "port or on another computer cannot be seen from here",
        "start QGroundControl here, or look for the vehicle: follower preflight --connect …",
    )


@SYSTEM.check("clock", "set by a time server: recordings and certificates have dates", needed=False)
def _clock(s: Installation) -> PreflightFinding:
    if s.clock_is_set is None:
        return unknown("the kernel does not say")
    if not s.clock_is_set:
        return warned("not synchronised", "sudo timedatectl set-ntp true, and a network")
    return passed("synchronised")


@SYSTEM.check("governor", "the processor's frequency is not held down", needed=False)
def _governor(s: Installation) -> PreflightFinding:
    if not s.governors:
        return unknown("this computer does not report it")
    text = ", ".join(sorted(s.governors))
    if s.governors & _SLOW_GOVERNORS:
        files = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
        return warned(text, f"echo performance | sudo tee {files}")
    return passed(text)


DOCTOR_CHECKS: tuple[PreflightCheck[Installation], ...] = (
    *SOFTWARE.checks,
    *DEVICES.checks,
    *SYSTEM.checks,
    *COMPUTER.checks,
)
SETTINGS_CHECKS: tuple[PreflightCheck[Installation], ...] = tuple(
    check for check in CAMERA.checks if check.name in _OF_SETTINGS
)
"""What is checked besides where the user gives settings."""


def examine(s: Installation, own_settings: bool) -> list[PreflightResult]:
    """Judge an installation by every check.

    Args:
        s: what was found out.
        own_settings: the user gave a file.
    """
    checks = (*DOCTOR_CHECKS, *(SETTINGS_CHECKS if own_settings else ()))
    return [PreflightResult(check, check.judge(s)) for check in checks]


def _listed(devices: Sequence[DeviceFile]) -> str:
    return ", ".join(map(str, devices))


def _permission(devices: Sequence[DeviceFile]) -> str:
    return permission_advice(str(devices[0].path))
