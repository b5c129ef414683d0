"""`follower service`: the files with which systemd starts the follower when the computer starts."""

from __future__ import annotations

import os
import pwd
import re
import shlex
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from follower.links.connections import check_connection
from follower.settings.settings import Settings, configs_folder, load_settings
from follower.ui.terminal.cli_options import Camera, Connect
from follower_control.common.strict_config import SettingsError
from follower_vision.disk import write_whole
from follower_vision.models import ModelStore, default_folder
from follower_vision.onnx_network import ModelError

service_app = typer.Typer(no_args_is_help=True, rich_markup_mode="markdown")
_UNIT, _ENVIRONMENT = Path("etc/systemd/system/follower.service"), Path("etc/follower/follower.env")
_RULES = Path("etc/udev/rules.d/60-follower.rules")
_PLAIN = re.compile(r"/[\w./@+-]+")
_HOMES = ("/home/", "/root/", "/run/user/")
_SERIAL = re.compile(r"(?:serial:)?(/[^:,\s]+)")
_EPILOG = """
**Example**

`sudo /opt/follower/bin/follower service install --connect /dev/ttyAMA0:921600 --camera 0 --select
person -c drone.yaml --dry-run` – show it; without --dry-run write it

The service follows from when the computer starts: docs/tutorials/raspberry-pi.md, step 9. systemd
starts it anew after an error and its journal keeps what it says. It has no watchdog: the program
does not report to one.
"""


@service_app.command(epilog=_EPILOG)
def install(
    connect: Connect,
    *,
    camera: Camera = None,
    select: Annotated[str, typer.Option(metavar="CLASS[:N]", help="What to follow.")],
    config: Annotated[Path, typer.Option("--config", "-c", help="Settings (YAML).")],
    user: Annotated[
        str | None, typer.Option(help="Who runs it; by default who calls this, also by sudo.")
    ] = None,
    root: Annotated[Path, typer.Option(help="Write below another folder than /.")] = Path("/"),
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the files alone.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Write a systemd unit for this environment, its settings, and a udev rule for the port."""
    from follower.apps.video_input import VideoInput

    name = user or os.environ.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name
    models = _models_folder(name)
    files = {
        _UNIT: _unit(name, config, models),
        _ENVIRONMENT: _environment(CONNECT=connect, CAMERA=camera or "", SELECT=select),
        _RULES: _rules(connect),
    }
    # Or the service would fail every five seconds.
    settings = load_settings(config)
    video = VideoInput.camera(camera, settings.camera)
    _check_files(settings, video.name)
    _check_selection(select, settings, models)
    check_connection(connect)
    files = {root / path: text for path, text in files.items() if text}
    if dry_run:
        for path, text in files.items():
            typer.echo(f"# {path}\n{text}")
        return
    if there := [path for path in files if path.exists() and not force]:
        raise SettingsError(f"{there[0]} exists already: compare it with --dry-run, or --force")
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        # A camera's address may have a password in it.
        typer.echo(_write(path, text, 0o600 if path == root / _ENVIRONMENT else 0o644))
    typer.echo("Now type: sudo udevadm control --reload && sudo udevadm trigger")
    typer.echo("          sudo systemctl daemon-reload && sudo systemctl enable --now follower")


def _environment(**values: str) -> str:
    """Return systemd's EnvironmentFile, whose quotes are a shell's."""
    return "".join(f"{name}={shlex.quote(value)}\n" for name, value in values.items())


def _write(path: Path, text: str, mode: int) -> Path:
    """Write a file that has the rights of `mode` from its first moment."""
    before = os.umask(0o777 & ~mode)
    try:
        return write_whole(path, text)
    finally:
        os.umask(before)


def _models_folder(user: str) -> Path:
    """Return where a user's networks are.

    Raises:
        SettingsError: there is no such user.
    """
    try:
        home = pwd.getpwnam(user).pw_dir
    except KeyError:
        raise SettingsError(f"--user {user}: there is no such user") from None
    return default_folder({"XDG_CACHE_HOME": f"{home}/.cache", **os.environ})


def _check_files(settings: Settings, camera: str) -> None:
    """Refuse files that are named from the present folder: the service runs in another one.

    Raises:
        SettingsError: says which.
    """
    named = {
        "detector": settings.detector,
        "fusion.model": settings.fusion.model,
        "link.signing_key_file": settings.link.signing_key_file,
        "cockpit.token_file": settings.cockpit.token_file,
        "camera.source": camera,
    }
    for key, name in named.items():
        if name is not None and Path(name).is_file() and not Path(name).is_absolute():
            raise SettingsError(
                f"{key}: write {Path(name).resolve()}, not {name}: the service runs in another "
                "folder"
            )


def _check_selection(select: str, settings: Settings, models: Path) -> None:
    """Refuse what is no selection; a class that is none, where the detector's network is there.

    Raises:
        SettingsError: it can select nothing.
        PluginError: another package's detector cannot be used.
    """
    from follower.apps.command_settings import usual_detector
    from follower.flight.target.selectors import Wanted
    from follower_vision.detection import make_detector

    names = None
    with suppress(ModelError):  # it may be fetched later
        names = make_detector(settings.detector or usual_detector(), ModelStore(models)).class_names
    Wanted.parse(select, names)


def _unit(user: str, config: Path, models: Path) -> str:
    """Return the unit that comes along, for a user, this environment and a settings file.

    Raises:
        SettingsError: there is no such file, or a path that systemd would read otherwise.
    """
    program, settings = Path(sys.executable).parent / "follower", config.resolve()
    for path in (program, settings):
        if not path.is_file():
            raise SettingsError(f"{path}: there is no such file")
    for path in (program, settings, models):
        if not _PLAIN.fullmatch(str(path)):
            raise SettingsError(f"{path}: move it to a path of letters, digits and ._-+@ alone")
    text = (configs_folder() / "systemd" / _UNIT.name).read_text("utf-8")
    for before, after in {
        "User=follower": f"User={user}",
        "/opt/follower/bin/follower": str(program),
        "/etc/follower/drone.yaml": str(settings),
        "/var/lib/follower/models": str(models),
    }.items():
        text = text.replace(before, after)
    if any(str(path).startswith(_HOMES) for path in (program, settings, models)):
        text = text.replace("ProtectHome=yes", "ProtectHome=read-only")
    return text


def _rules(connect: str, sysfs: Path = Path("/sys")) -> str:
    """Return a udev rule that gives a serial port to dialout and keeps ModemManager off; or "".

    Raises:
        SettingsError: the port is named by a link that is not there now.
    """
    match = _SERIAL.match(connect)
    if match is None:
        return ""
    port = Path(match[1]).resolve().name
    if not (port.startswith("tty") or Path(match[1]).exists()):  # udev knows the kernel's names
        raise SettingsError(f"{match[1]}: plug it in, so that a rule can be written for its port")
    which = f'KERNEL=="{port}"'
    for usb in (sysfs / "class/tty" / port / "device").resolve().parents:
        if (usb / "idVendor").is_file():  # ttyACM0 may be another port's name tomorrow
            of = {key: (usb / key).read_text("utf-8").strip() for key in ("idVendor", "idProduct")}
            which = ", ".join(f'ATTRS{{{key}}}=="{value}"' for key, value in of.items())
            break
    return (
        f'SUBSYSTEM=="tty", {which}, GROUP="dialout", MODE="0660", ENV{{ID_MM_DEVICE_IGNORE}}="1"\n'
    )
