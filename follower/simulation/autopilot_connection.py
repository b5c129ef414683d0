"""Which autopilot a simulated flight has, and how MAVLink gets to it."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from rich.console import Console

from follower.links.connections import ConnectionFailedError, open_connection
from follower.simulation.options import EXTERNAL
from follower.simulation.sitl.programs import SitlProgram
from follower.ui.terminal.console import print_line
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport, Transport, UdpTransport

SITL_PORT = 14540
"""Of a companion computer; PX4's SITL sends there."""
FLAVOURS = ("px4", "ardupilot", EXTERNAL)


@dataclass(frozen=True, slots=True)
class AutopilotConnection:
    """The two ends between the follower and the autopilot.

    Attributes:
        flavour: "px4" or "ardupilot", or "external" for one that runs elsewhere.
        lockstep: on a simulated clock, through memory.
        address: the follower's end as pymavlink writes it; None for a usual or a free UDP port.
        program: will be started and speak at the port that is opened for it.

    Raises:
        SettingsError: there is no such autopilot, or lockstep does not go with it or the address.
    """

    flavour: str
    lockstep: bool
    address: str | None
    program: SitlProgram | None = None

    def __post_init__(self) -> None:
        if self.flavour not in FLAVOURS:
            raise SettingsError(f"--autopilot {self.flavour}: choose {' or '.join(FLAVOURS)}")
        if self.lockstep:
            self.check_simulated("--lockstep")
            if self.address is not None:
                raise SettingsError("--lockstep: nothing leaves the program; leave out --connect")

    def check_simulated(self, option: str) -> None:
        """Refuse an option that needs a simulated autopilot where there is none.

        Raises:
            SettingsError: the autopilot runs elsewhere.
        """
        if self.flavour == EXTERNAL:
            raise SettingsError(f"{option} needs a simulated autopilot: px4 or ardupilot")

    @contextmanager
    def open(self, console: Console) -> Iterator[tuple[Transport, Transport]]:
        """Open the follower's end and the autopilot's: memory in lockstep, else real sockets.

        Raises:
            ConnectionFailedError: one cannot be opened.
        """
        if self.lockstep:
            yield MemoryTransport.pair()
        elif self.program is not None:
            with closing(self.program.listen()) as ours:
                yield ours, MemoryTransport.pair()[1]
        elif self.flavour == EXTERNAL:
            with closing(open_connection(self.address or f"udpin:127.0.0.1:{SITL_PORT}")) as ours:
                yield ours, MemoryTransport.pair()[1]
        elif self.address is not None:
            with (
                closing(open_connection(self.address)) as ours,
                closing(open_connection(other_end(self.address))) as theirs,
            ):
                yield ours, theirs
        else:
            listener, speaker = UdpTransport.pair(SITL_PORT)
            with closing(listener), closing(speaker):
                if listener.port != SITL_PORT:
                    text = f"UDP port {SITL_PORT} is in use; MAVLink is spoken at {listener.port}"
                    print_line(console, text)
                yield listener, speaker


def other_end(address: str) -> str:
    """Return the address that a simulated autopilot has to open for this one of ours."""
    kind, _, place = address.partition(":")
    place = place.replace("0.0.0.0", "127.0.0.1")  # noqa: S104  read, not bound
    others = {"udpin": "udpout", "udp": "udpout", "udpout": "udpin", "tcpin": "tcp"}
    if kind not in others:
        raise ConnectionFailedError(
            f"{address}: a simulated autopilot is reached by udpin:, udpout: or tcpin:; "
            "use --autopilot external for one that runs elsewhere"
        )
    return f"{others[kind]}:{place}"
