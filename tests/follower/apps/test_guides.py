"""The guides say what the program says, and link to what is there."""

import configparser
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from follower.apps.fly import flight
from follower.apps.main import app
from follower.apps.preflight.checklist import CHECKS
from follower.flight.supervision.supervisor import SupervisorReason

ROOT = Path(__file__).parents[3]
GUIDES = (
    *(f"tutorials/{name}.md" for name in ("raspberry-pi", "simulator")),
    *(f"how-to/{name}.md" for name in ("calibrate", "cockpit", "fly", "ground-station")),
    *(f"how-to/{name}.md" for name in ("live-video", "offline-flight", "sitl", "troubleshooting")),
    *(f"reference/{name}.md" for name in ("envelope", "faults", "flight-log", "follow-modes")),
    *(f"reference/{name}.md" for name in ("links", "supervisor")),
)
PACKAGES = ("follower", "control/follower_control", "vision/follower_vision")
GLUED = re.compile(r'"\s*\n\s*f?"')
CODE = re.compile(r"`([^`]+)`")
SVG = "{http://www.w3.org/2000/svg}"
UNIT = ROOT / "configs" / "systemd" / "follower.service"


def guide(name: str) -> str:
    return (ROOT / "docs" / name).read_text("utf-8")


@pytest.fixture(scope="module")
def sources() -> str:
    """All our code, with strings that go on in the next line glued together."""
    texts = (p.read_text("utf-8") for package in PACKAGES for p in (ROOT / package).rglob("*.py"))
    return GLUED.sub("", "\n".join(texts))


def first_cells(text: str, heading: str) -> list[str]:
    section = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")]
    return [row.split(" | ")[0].removeprefix("| ") for row in rows[1:]]


def parts(phrase: str) -> list[str]:
    """Return what of a phrase stands still: around … and example names."""
    pieces = re.split(r"…|/dev/\w+\d*|\b\d+\b(?: of [\d.]+)?|\budpin:", phrase)
    return [piece.strip(" :()") for piece in pieces if len(piece.split()) > 1]


@pytest.mark.parametrize(
    ("page", "heading"),
    [
        ("how-to/troubleshooting.md", "Starting"),
        ("how-to/calibrate.md", "What it refuses"),
        ("how-to/sitl.md", "If it does not fly"),
    ],
)
def test_errors_of_the_tables_are_the_programs_own(page: str, heading: str, sources: str) -> None:
    phrases = [p for cell in first_cells(guide(page), heading) for p in CODE.findall(cell)]
    assert len(phrases) > 5
    missing = [part for phrase in phrases for part in parts(phrase) if part not in sources]
    assert missing == []


def test_checks_and_reasons_of_the_tables_exist() -> None:
    text = guide("how-to/troubleshooting.md")
    checks = {name for cell in first_cells(text, "The checklist") for name in CODE.findall(cell)}
    assert checks <= {check.name for check in CHECKS}
    released = first_cells(text, "It released the vehicle")
    reasons = {name for cell in released for name in CODE.findall(cell)}
    assert reasons <= set(map(str, SupervisorReason))
    assert len(reasons) > 8


def test_every_line_that_the_terminal_waits_with_is_in_the_table() -> None:
    table = guide("how-to/fly.md")
    lines = [*flight._TROUBLES.values(), *flight._CONSENTS.values(), "waiting for the autopilot"]
    assert [line for line in lines if f'"{line}"' not in table] == []


@pytest.mark.parametrize("name", GUIDES)
def test_links_of_the_guides_lead_somewhere(name: str) -> None:
    found = re.findall(r"\]\(([^)#]+)", guide(name))
    assert found
    links = [one for one in found if not one.startswith("https://")]
    assert [one for one in links if not ((ROOT / "docs" / name).parent / one).exists()] == []


def test_pictures_are_there_and_small_and_need_nothing_from_elsewhere() -> None:
    pages = [path.read_text("utf-8") for path in (ROOT / "docs").glob("**/*.md")]
    names = {
        name for page in pages for name in re.findall(r"[(\"](?:\.\./)*(pictures/[^)\"]+)", page)
    }
    assert len(names) > 10
    for name in names:
        data = (ROOT / "docs" / name).read_bytes()
        assert len(data) < 150_000, name
        if name.endswith(".svg"):
            assert not re.search(rb"(?:href|src)\s*=|url\(\s*[^#\s]|@import", data), name


def test_the_drawing_of_the_wires_says_what_the_table_says() -> None:
    drawing = ElementTree.parse(ROOT / "docs" / "pictures" / "wiring.svg")
    texts = [element.text or "" for element in drawing.iter(f"{SVG}text")]
    (about,) = (element.text or "" for element in drawing.iter(f"{SVG}desc"))
    rows = re.findall(
        r"^\| (\d): (\w+) \| . \| pin (\d+): (.+) \|$",
        guide("tutorials/raspberry-pi.md"),
        re.MULTILINE,
    )
    assert len(rows) == 3
    for pin, name, to, what in rows:
        assert f"{pin}: {name}" in texts
        assert f"{to}: {what}" in texts
        assert re.search(
            rf"pin {pin} \({name}\) (?:goes )?to (?:the Raspberry Pi's )?pin {to} ", about
        )


def test_the_service_stops_by_holding_and_is_begun_anew_only_after_an_error() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(UNIT, "utf-8")
    service = unit["Service"]
    assert service["KillSignal"] == "SIGTERM"
    assert service["Restart"] == "on-failure"
    assert int(service["TimeoutStopSec"]) >= 60, "6 s of holding, then recording and report"
    assert {"NoNewPrivileges", "ProtectSystem", "DevicePolicy"} <= set(service)
    named = set(re.findall(r"\$\{(\w+)\}", service["ExecStart"]))
    given = (UNIT.parent / "follower.env").read_text("utf-8")
    assert named == set(re.findall(r"^(\w+)=", given, re.MULTILINE))


def test_the_service_calls_a_command_that_is_there() -> None:
    import typer

    line = next(t for t in UNIT.read_text("utf-8").splitlines() if t.startswith("ExecStart="))
    words = line.split()[1:]
    group = typer.main.get_command(app)
    command = group.commands[words[0]]  # type: ignore[attr-defined]
    context = command.context_class(command, info_name="follower")
    _, left, _ = command.make_parser(context).parse_args(words[1:])
    assert left == []
