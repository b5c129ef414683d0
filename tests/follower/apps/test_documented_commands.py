"""Each `follower …` line of the README, the pages and the help exists, with the options used.

Nothing is run: lines are read with the parsers of the commands themselves.
"""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from typer.exceptions import TyperException
from typer.testing import CliRunner

from follower.apps.main import app
from follower.settings.settings import find_scenario, load_settings
from follower.simulation.faults.fault import fault_named
from follower_control.common.strict_config import SettingsError

ROOT = Path(__file__).parents[3]
PAGES = (
    *(ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))),
    *sorted((ROOT / "examples").glob("*/README.md")),
)
FENCED = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`(follower [^`\n]+)`")
OTHER_SETTINGS = ("detector", "fusion", "campaign")
"""Commands whose --set is not of a flight's settings alone."""
BRACKETS = re.compile(r"[][]")
BEGINS = re.compile(r"^(?:\$ )?(?:\.venv/bin/|/\S*/bin/|ExecStart=/\S*/)?(follower\s.*)$")
LEFT_OUT = {"…", "..."}
GROUP = typer.main.get_command(app)


WORDS = re.compile(r"[a-z][a-z-]*")


def fenced(text: str) -> Iterator[str]:
    """Yield the commands of a page's code blocks, continued lines joined."""
    for language, block in FENCED.findall(text):
        if language not in ("", "bash", "sh", "console", "ini", "text"):
            continue
        for line in block.replace("\\\n", " ").splitlines():
            if match := BEGINS.match(line.strip()):
                yield match[1]


def inline(text: str) -> Iterator[str]:
    """Yield the commands in running text, which may end in an option that it only names."""
    for line in INLINE.findall(FENCED.sub("", text)):
        yield f"{line} …" if "requires an argument" in problem_with(line) else line


def words_of(line: str) -> list[str]:
    """Return a command's words, without a comment, a redirection or what is behind a pipe."""
    shell = shlex.shlex(line, posix=True, punctuation_chars="|>;&")
    shell.whitespace_split = True
    words: list[str] = []
    for word in shell:
        if word == "--ros-args" or (word and set(word) <= set("|>;&")):
            break  # what follows is another program's, or ROS's
        words.append(word)
    return words[1:]


def command_of(words: list[str]) -> tuple[Any, list[str]]:
    """Return the command that is meant, and what is left for it."""
    command: Any = GROUP
    while words and hasattr(command, "commands") and not words[0].startswith("-"):
        if words[0] not in command.commands:
            if hasattr(command, "default"):
                break
            raise ValueError(f"there is no command {words[0]!r}")
        command, words = command.commands[words[0]], words[1:]
    if hasattr(command, "default"):
        command = command.commands[command.default]
    return command, words


def problem_with(line: str) -> str:
    """Say what is wrong with a documented command; "" if nothing is."""
    try:
        command, rest = command_of(words_of(BRACKETS.sub("", line)))
        context = command.context_class(command, info_name="follower")
        values, left, _ = command.make_parser(context).parse_args(rest)
    except (ValueError, TyperException) as error:
        return f"{line}: {error}"
    return wrong_value(line, command, values, left)


def wrong_value(line: str, command: Any, values: dict[str, Any], left: list[str]) -> str:
    """Say what a command would refuse of the names and settings it is given."""
    if not_said := [word for word in left if word not in LEFT_OUT]:
        return f"{line}: too much: {not_said}"
    for text in (values.get("overrides") or ()) if command.name not in OTHER_SETTINGS else ():
        key, _, value = text.partition("=")
        if not knows_setting(key, yaml.safe_load(value)):
            return f"{line}: no setting {text}"
    for text in values.get("faults") or ():
        if text not in ("list", "NAME@time:duration"):
            fault_named(text.partition("@")[0])
    scenario = values.get("scenario")
    if command.name == "sim" and scenario and WORDS.fullmatch(str(scenario)):
        find_scenario(scenario)
    return ""


def knows_setting(key: str, value: Any) -> bool:
    if "$" in str(value) or "…" in str(value):
        return True
    try:
        load_settings(overrides=[f"{key}={yaml.safe_dump(value, default_flow_style=True)[:-1]}"])
    except SettingsError as error:
        return "unknown" not in str(error) and "no such" not in str(error)
    return True


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_of_a_page_exist_with_their_options(page: Path) -> None:
    text = page.read_text("utf-8")
    lines = [*fenced(text), *inline(text)]
    assert [wrong for line in lines if (wrong := problem_with(line))] == []


def helps(command: Any, name: str = "follower") -> Iterator[tuple[str, str]]:
    yield name, f"{command.help or ''}\n{command.epilog or ''}"
    for one, below in getattr(command, "commands", {}).items():
        yield from helps(below, f"{name} {one}")


def test_commands_of_the_help_exist_with_their_options() -> None:
    texts = dict(helps(GROUP))
    assert sum(len(list(inline(text))) for text in texts.values()) > 20
    wrong = [
        problem
        for text in texts.values()
        for line in inline(text)
        if (problem := problem_with(line))
    ]
    assert wrong == []


def test_the_help_begins_with_the_demo_and_says_what_each_command_is_for() -> None:
    commands: dict[str, Any] = getattr(GROUP, "commands", {})
    assert next(iter(commands)) == "demo"
    assert [name for name, one in commands.items() if not one.rich_help_panel] == []


def silent(command: Any, name: str = "follower") -> Iterator[str]:
    """Yield the options and arguments that say nothing of what they are for."""
    yield from (f"{name} {one.name}" for one in command.params if not one.help)
    for one, below in getattr(command, "commands", {}).items():
        yield from silent(below, f"{name} {one}")


def test_the_help_says_what_each_option_is_for() -> None:
    assert list(silent(GROUP)) == []


def test_the_help_of_trax_shows_a_file_line_by_line() -> None:
    said = CliRunner().invoke(app, ["trax", "--help"]).output
    lines = [line.strip() for line in said.splitlines()]
    assert lines.index("[Fusion]") < lines.index("protocol = trax")


def test_the_pages_have_commands_and_a_wrong_one_is_noticed() -> None:
    assert sum(len(list(fenced(page.read_text("utf-8")))) for page in PAGES) > 30
    assert problem_with("follower sim demo --lockstep > out.txt  # a comment") == ""
    assert "no command 'simulate'" in problem_with("follower simulate demo")
    assert "--quick" in problem_with("follower sim demo --quick")
    assert "too much" in problem_with("follower sim demo walker")
    assert "requires an argument" in problem_with("follower sim demo --seed")
    assert "no setting" in problem_with("follower sim demo --set servo.distance=3")
