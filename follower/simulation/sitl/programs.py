"""Autopilots in software-in-the-loop as programs: the user's own builds, and our simulated ones."""

import math
import os
import re
import socket
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from follower.links.connections import ConnectionFailedError
from follower.settings.settings import configs_folder
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import UdpTransport
from follower_sim.scenario.scenario import Scenario, WindSettings

_LOOPBACK = "127.0.0.1"
_HOME = "-35.363262,149.165237,584,0"
"""Where ArduPilot's own SITL begins: latitude, longitude, metres above the sea, heading."""
_PX4_INSTANCES, _PX4_OUR_PORT = 10, 14540
_PX4_PORTS = (14580, 18570, 14280, 13030, 19450)
"""Which an instance binds, each with its number added."""
_SIH_WIND_SINCE = (1, 18)
_ARDUCOPTER = re.compile(rb"\b(ArduCopter|ArduPlane|ArduRover|ArduSub) V(\d+)\.(\d+)\.(\d+)")
_PX4 = re.compile(r'PX4_GIT_TAG_STR\s+"v?(\d+)\.(\d+)\.(\d+)')

Version = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class SitlSetup:
    """How a program is started.

    Attributes:
        speedup: how many simulated seconds pass in a real one.
        parameters: of the autopilot, by name.
        file: where they are from, None for the usual ones.
    """

    speedup: float = 1.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    file: Path | None = None


@dataclass(frozen=True, slots=True)
class ProgramStart:
    """The command line and what is added to the environment."""

    command: Sequence[str]
    environment: Mapping[str, str]


class SitlProgram(ABC):
    """An autopilot that can be started; knows its ports, its parameters and its own log.

    Args:
        path: the program or its build folder.

    Attributes:
        port: the follower's, from `listen` on.
        option: of `follower sitl`, that names it.
        flavour: "px4" or "ardupilot".
        known: versions with which it was flown.
        least: the oldest that is tried.
        parameter_file: in configs/sitl, its usual parameters; "" where it needs none.
        log: a pattern of its own log's files, in its working folder.

    Raises:
        SettingsError: it is not that program, or too old.
    """

    option: str
    name: str
    flavour: str
    known: tuple[tuple[int, int], ...] = ()
    least: tuple[int, int] = (0, 0)
    parameter_file: str = ""
    log: str

    def __init__(self, path: Path) -> None:
        self.path = path.expanduser().absolute()
        self.port = 0
        self.version = self._read_version()
        if self.version is not None and self.version[:2] < self.least:
            raise SettingsError(
                f"{self.option} {path}: {self.title} is too old; known to work: {self._versions}"
            )

    @property
    def title(self) -> str:
        """Name and version, for people."""
        return self.name + (
            "" if self.version is None else f" {'.'.join(str(part) for part in self.version)}"
        )

    @property
    def words(self) -> tuple[str, ...]:
        """The command line's words that choose it."""
        return self.option, str(self.path)

    @property
    def remark(self) -> str:
        """What is to be said of its version, "" if it is one of those known."""
        if not self.known or (self.version is not None and self.version[:2] in self.known):
            return ""
        return f"{self.title} was not tried with this follower; known to work: {self._versions}."

    def usual_parameters(self) -> dict[str, float]:
        """Return the parameters that it is started with, from configs/sitl."""
        if not self.parameter_file:
            return {}
        return read_parameters(configs_folder() / "sitl" / self.parameter_file)

    @property
    def _versions(self) -> str:
        return f"{self.name} {', '.join(f'{major}.{minor}' for major, minor in self.known)}"

    def listen(self) -> UdpTransport:
        """Open the follower's end, at a free port to which the program will send.

        Raises:
            ConnectionFailedError: there is none.
        """
        ours = UdpTransport.listen(_LOOPBACK, 0)
        self.port = ours.port
        return ours

    @abstractmethod
    def start(self, folder: Path, setup: SitlSetup) -> ProgramStart:
        """Return how it is started in a folder of its own, to send to the follower's end."""

    @abstractmethod
    def wind(self, wind: WindSettings, heading_deg: float) -> dict[str, float]:
        """Return the parameters of a wind, in a scenario that starts with this heading.

        The vehicle stands facing north in the autopilot's world, and the scenario's world is
        turned onto that (see `TelemetryVehicle`).
        """

    def air(self, north_m_s: float, east_m_s: float) -> dict[str, float]:  # noqa: ARG002
        """Return parameters that say in flight how the air moves; none if it cannot be told."""
        return {}

    def for_scenario(self, scenario: Scenario, parameters: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters with the scenario's wind, where those given say nothing of it."""
        return {**self.wind(scenario.wind, scenario.start.heading_deg), **parameters}

    def lacks(self, scenario: Scenario) -> str:  # noqa: ARG002  most can do all of them
        """Return what of a scenario its simulator cannot do, "" if it can do all."""
        return ""

    @abstractmethod
    def _read_version(self) -> Version | None:
        """Return the version, None if it cannot be told."""

    def _refuse(self, why: str) -> SettingsError:
        return SettingsError(f"{self.option} {self.path}: {why}")


class ArduCopterProgram(SitlProgram):
    """ArduPilot's `build/sitl/bin/arducopter`, with its own physics ("+" quadrotor)."""

    option, name, flavour = "--arducopter", "ArduCopter", "ardupilot"
    known, least = ((4, 6), (4, 7)), (4, 5)
    parameter_file, log = "arducopter.parm", "logs/*.BIN"

    def start(self, folder: Path, setup: SitlSetup) -> ProgramStart:
        """Return the command; its ports for others are closed, or any free ones."""
        defaults = folder / "start.parm"
        rows = setup.parameters.items()
        defaults.write_text("".join(f"{name} {value:.9g}\n" for name, value in rows), "utf-8")
        command = [str(self.path), "--model", "+", "--home", _HOME]
        command += ["--speedup", f"{setup.speedup:g}", "--defaults", str(defaults)]
        command += ["--rc-in-port", str(_free_port()), "--irlock-port", str(_free_port())]
        command += ["--serial0", f"udpclient:{_LOOPBACK}:{self.port}"]
        command += ["--serial1", "none", "--serial2", "none"]  # ground stations' TCP ports
        return ProgramStart(command, {})

    def wind(self, wind: WindSettings, heading_deg: float) -> dict[str, float]:
        """Return SIM_WIND_* of a wind that is the same at every height and changes at once.

        By default there is half as much at 15 m as at 60 m, and it takes 5 s to change.
        """
        towards = math.radians(wind.from_deg + 180.0 - heading_deg)
        air = self.air(wind.mean_m_s * math.cos(towards), wind.mean_m_s * math.sin(towards))
        return {**air, "SIM_WIND_T": 1, "SIM_WIND_TC": 0.1}

    def air(self, north_m_s: float, east_m_s: float) -> dict[str, float]:
        """Return SIM_WIND_*, which say where it comes from."""
        return {
            "SIM_WIND_SPD": round(math.hypot(north_m_s, east_m_s), 3),
            "SIM_WIND_DIR": round(math.degrees(math.atan2(-east_m_s, -north_m_s)) % 360.0, 3),
        }

    def _read_version(self) -> Version | None:
        if self.path.is_dir():
            raise self._refuse("this is a folder; name the program, build/sitl/bin/arducopter")
        try:
            content = self.path.read_bytes()
        except OSError as error:
            raise self._refuse(f"{error.strerror}; build it by `waf copter`") from None
        match = _ARDUCOPTER.search(content)
        if match is None:
            raise self._refuse("this is not ArduCopter: it does not name itself so")
        if match[1] != b"ArduCopter":
            raise self._refuse(f"this is {match[1].decode()}; ArduCopter is needed")
        if not os.access(self.path, os.X_OK):
            raise self._refuse("this file cannot be executed: chmod +x")
        return int(match[2]), int(match[3]), int(match[4])


class Px4Program(SitlProgram):
    """PX4's `build/px4_sitl_default`, with its simulation-in-hardware quadrotor (SIH)."""

    option, name, flavour = "--px4", "PX4", "px4"
    known, least = ((1, 17), (1, 18)), (1, 15)
    parameter_file, log = "px4.params", "log/*/*.ulg"

    def listen(self) -> UdpTransport:
        """Open the follower's end at the port to which the first free instance sends."""
        for instance in range(_PX4_INSTANCES):
            try:
                listener = UdpTransport.listen(_LOOPBACK, _PX4_OUR_PORT + instance)
            except OSError:
                continue
            if all(_is_free(port + instance) for port in _PX4_PORTS):
                self.port = listener.port
                return listener
            listener.close()
        last = _PX4_OUR_PORT + _PX4_INSTANCES - 1
        raise ConnectionFailedError(
            f"the UDP ports of all PX4 instances ({_PX4_OUR_PORT} to {last} and those that go with "
            "them) are in use: end the PX4s that are still running"
        )

    def start(self, folder: Path, setup: SitlSetup) -> ProgramStart:
        """Return the command, with the parameters in the environment as PX4 reads them."""
        program, instance = self.path / "bin" / "px4", self.port - _PX4_OUR_PORT
        command = [str(program), "-d", "-i", str(instance), "-w", str(folder)]
        rows = setup.parameters.items()
        environment = {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in rows}
        environment["PX4_SIM_MODEL"] = "sihsim_quadx"
        environment["PX4_SIM_SPEED_FACTOR"] = f"{setup.speedup:g}"
        return ProgramStart([*command, str(self.path / "etc")], environment)

    def wind(self, wind: WindSettings, heading_deg: float) -> dict[str, float]:
        """Return SIH_WIND_*, which say where it comes from.

        There are no gusts: where they change often, PX4 stops in flight while it saves them.
        """
        if self._has_no_wind:
            return {}
        source = math.radians(wind.from_deg - heading_deg)
        north, east = wind.mean_m_s * math.cos(source), wind.mean_m_s * math.sin(source)
        return {"SIH_WIND_N": round(north, 3), "SIH_WIND_E": round(east, 3)}

    def for_scenario(self, scenario: Scenario, parameters: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters with the scenario's wind and drag: SIH's own is four times as much.

        SIH_KDV is a force per velocity; its quadrotor weighs 1 kg.
        """
        drag = scenario.vehicle.drag
        known = {} if drag is None else {"SIH_KDV": drag.linear_per_s}
        return {**known, **super().for_scenario(scenario, parameters)}

    def lacks(self, scenario: Scenario) -> str:
        """Return what of a scenario its simulator cannot do, "" if it can do all."""
        if scenario.wind.mean_m_s and self._has_no_wind:
            return f"The simulator of {self.title} has no wind: this was flown in still air."
        if scenario.wind.gust_m_s:
            return "PX4's simulator has no gusts: this was flown in a steady wind."
        return ""

    @property
    def _has_no_wind(self) -> bool:
        return self.version is not None and self.version[:2] < _SIH_WIND_SINCE

    def _read_version(self) -> Version | None:
        needed = ("bin/px4", "etc/init.d-posix/rcS")
        missing = [name for name in needed if not (self.path / name).is_file()]
        if missing:
            raise self._refuse(
                f"this is not PX4's build folder: {missing[0]} is missing in it; build it by "
                "`make px4_sitl_default` and name build/px4_sitl_default"
            )
        if not list((self.path / "etc" / "init.d-posix" / "airframes").glob("*_sihsim_quadx")):
            raise self._refuse("this build has no SIH quadrotor (airframe sihsim_quadx)")
        header = self.path / "src" / "lib" / "version" / "build_git_version.h"
        match = _PX4.search(header.read_text("utf-8", "replace")) if header.exists() else None
        return None if match is None else (int(match[1]), int(match[2]), int(match[3]))


class SimulatedProgram(SitlProgram):
    """Our own simulated autopilot in a process of its own, where no other is at hand."""

    option, name = "--simulated", "simulated"
    log = "*.csv"

    @property
    def words(self) -> tuple[str, ...]:
        """The command line's words that choose it."""
        return self.option, self.flavour

    def __init__(self, flavour: str) -> None:
        if flavour not in ("px4", "ardupilot"):
            raise SettingsError(f"{self.option} {flavour}: choose px4 or ardupilot")
        self.flavour = flavour
        super().__init__(Path(sys.executable))

    @property
    def title(self) -> str:
        """Name and kind, for people."""
        return f"{self.name} {self.flavour}"

    def start(self, folder: Path, setup: SitlSetup) -> ProgramStart:
        """Return the command that runs it by this Python."""
        module = "follower.simulation.sitl.simulated_autopilot"
        command = [sys.executable, "-m", module, self.flavour]
        command += [str(self.port), f"{setup.speedup:g}"]
        rows = setup.parameters.items()
        command += [str(folder / "flight.csv"), *(f"{name}={value:.9g}" for name, value in rows)]
        return ProgramStart(command, {})

    def wind(self, wind: WindSettings, heading_deg: float) -> dict[str, float]:
        """Return WIND_*, which it knows from its command line alone."""
        from_deg = (wind.from_deg - heading_deg) % 360.0
        return {"WIND_MEAN": wind.mean_m_s, "WIND_FROM": from_deg, "WIND_GUST": wind.gust_m_s}

    def _read_version(self) -> Version | None:
        return None


def read_parameters(path: Path) -> dict[str, float]:
    """Read a file of parameters: `NAME VALUE` a line, also with a comma; # begins a comment.

    Raises:
        SettingsError: it cannot be read, or a line is something else.
    """
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    parameters = {}
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            name, value = words
            parameters[name] = _finite(value)
        except ValueError:
            raise SettingsError(f"{path}:{number}: write NAME VALUE, not {line!r}") from None
    return parameters


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((_LOOPBACK, 0))
        return int(sock.getsockname()[1])


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind(("", port))
        except OSError:
            return False
    return True
