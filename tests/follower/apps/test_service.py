"""`follower service install` writes what systemd and udev take, and overwrites nothing."""

from __future__ import annotations

import getpass
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from follower.apps.service import _rules

UNIT, ENVIRONMENT, RULES = (
    "etc/systemd/system/follower.service",
    "etc/follower/follower.env",
    "etc/udev/rules.d/60-follower.rules",
)
Install = Callable[..., Any]


@pytest.fixture
def install(
    tmp_path: Path, run_command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> Install:
    """Run it for an environment that has a program, and settings, below the folder `root`."""
    program = tmp_path / "venv/bin/follower"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n", "utf-8")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program.with_name("python")))
    monkeypatch.delenv("SUDO_USER", raising=False)
    monkeypatch.setenv("FOLLOWER_MODELS", "/srv/models")
    (tmp_path / "drone.yaml").write_text("camera: {fov_deg: 70}\n", "utf-8")

    def run(*arguments: str, connect: str = "/dev/ttyAMA0:921600") -> Any:
        options = ("--connect", connect, "--camera", "0", "--select", "person")
        where = ("-c", "drone.yaml", "--root", str(tmp_path / "root"))
        return run_command("service", "install", *options, *where, *arguments)

    return run


def written(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_the_files_are_for_this_user_environment_and_settings(
    install: Install, tmp_path: Path
) -> None:
    ended = install()
    assert (ended.code, ended.err) == (0, "")
    root = tmp_path / "root"
    assert written(root) == {UNIT, ENVIRONMENT, RULES}
    unit = (root / UNIT).read_text("utf-8")
    assert f"\nUser={getpass.getuser()}\n" in unit
    assert f"\nExecStart={tmp_path}/venv/bin/follower fly " in unit
    assert f" -c {tmp_path}/drone.yaml " in unit
    assert "FOLLOWER_MODELS=/srv/models\n" in unit
    assert "/opt/follower" not in unit
    assert "Watchdog" not in unit, "the program does not report to one"
    assert "\nDeviceAllow=char-dma_heap rw\n" in unit, "libcamera takes its buffers there"
    assert "\nSuccessExitStatus=3 4 130\n" in unit, "stopped during the checks is no failure"
    lines = (root / ENVIRONMENT).read_text("utf-8").splitlines()
    assert lines == ["CONNECT=/dev/ttyAMA0:921600", "CAMERA=0", "SELECT=person"]
    assert 'KERNEL=="ttyAMA0"' in (root / RULES).read_text("utf-8")
    assert "sudo systemctl daemon-reload" in ended.out


def test_a_value_reaches_the_program_as_it_was_written(install: Install, tmp_path: Path) -> None:
    camera = r"""rtsp://pilot:a\b"c'd$HOME`e`#f g@10.0.0.2/live?x=1&y=%20"""
    assert install("--camera", camera).code == 0
    # systemd reads quotes as a shell does, and expands nothing.
    code = f'. {tmp_path}/root/{ENVIRONMENT}; printf "%s|%s|%s" "$CONNECT" "$CAMERA" "$SELECT"'
    said = subprocess.run(["/bin/sh", "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout == f"/dev/ttyAMA0:921600|{camera}|person"


def test_only_root_reads_the_environment_where_a_password_may_be(
    install: Install, tmp_path: Path
) -> None:
    install()
    modes = {name: (tmp_path / "root" / name).stat().st_mode & 0o777 for name in (UNIT, RULES)}
    assert modes == {UNIT: 0o644, RULES: 0o644}
    assert (tmp_path / "root" / ENVIRONMENT).stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_takes_the_unit(install: Install, tmp_path: Path) -> None:
    install()
    unit = tmp_path / "root" / UNIT
    command = ["systemd-analyze", "verify", "--man=no", str(unit)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert [line for line in said.stderr.splitlines() if "follower" in line] == []
    unit.write_text(unit.read_text("utf-8").replace("Restart=on-failure", "Restart=oftn"), "utf-8")
    said = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert "oftn" in said.stderr


def test_a_dry_run_shows_the_files_and_writes_none(install: Install, tmp_path: Path) -> None:
    ended = install("--dry-run")
    assert ended.code == 0
    for path in (UNIT, ENVIRONMENT, RULES):
        assert f"# {tmp_path}/root/{path}\n" in ended.out
    assert "SELECT=person" in ended.out
    assert not (tmp_path / "root").exists()


def test_nothing_is_overwritten_without_force(install: Install, tmp_path: Path) -> None:
    own = tmp_path / "root" / ENVIRONMENT
    own.parent.mkdir(parents=True)
    own.write_text("CONNECT=mine\n", "utf-8")
    refused = install()
    assert refused.code == 2
    assert "follower.env exists already" in refused.err
    assert refused.err.count("\n") == 1
    assert written(tmp_path / "root") == {ENVIRONMENT}
    assert own.read_text("utf-8") == "CONNECT=mine\n"
    assert install("--force").code == 0
    assert "CONNECT=/dev/ttyAMA0:921600" in own.read_text("utf-8")


def test_a_link_over_the_network_needs_no_rule(install: Install, tmp_path: Path) -> None:
    assert install(connect="udpin:0.0.0.0:14540").code == 0
    assert written(tmp_path / "root") == {UNIT, ENVIRONMENT}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--user", "nobody-of-that-name"), "there is no such user"),
        (("-c", "absent.yaml"), "absent.yaml: there is no such file"),
        (("-c", "with space.yaml"), "move it to a path of letters"),
        (("--camera", ""), "which source? give a camera (0)"),
        (("-c", "mistyped.yaml"), "did you mean 'distance_m'"),
        (("--connect", "udpin:here"), "'udpin:here' is no connection"),
        (("--connect", "/dev/serial/by-id/usb-absent-if00:57600"), "absent-if00: plug it in, so"),
        (("--select", ""), "write a class, person:2, or 2"),
        (("--select", "person:0"), "write a class, person:2, or 2"),
        (("-c", "embedded.yaml", "--select", "persn"), "did you mean 'person'?"),
        (("-c", "own.yaml"), "link.signing_key_file: write /"),
        (("--camera", "stream.sdp"), "stream.sdp, not stream.sdp: the service runs in another"),
    ],
)
def test_what_cannot_be_used_is_told_in_one_line(
    install: Install, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    (tmp_path / "with space.yaml").touch()
    (tmp_path / "mistyped.yaml").write_text("servo: {distanc_m: 9}\n", "utf-8")
    (tmp_path / "embedded.yaml").write_text("detector: embedded\n", "utf-8")
    (tmp_path / "own.yaml").write_text("link: {signing_key_file: key}\n", "utf-8")
    for name in ("key", "stream.sdp"):
        (tmp_path / name).touch()
    ended = install(*arguments)
    assert ended.code == 2
    assert said in ended.err
    assert ended.err.count("\n") == 1
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize("driver", ["usb1/1-2/1-2:1.0", "usb1/1-2/1-2:1.0/ttyACM0"])
def test_a_port_on_usb_is_told_by_its_maker_not_by_its_number(tmp_path: Path, driver: str) -> None:
    device = tmp_path / "devices" / driver
    device.mkdir(parents=True)
    (tmp_path / "devices/usb1/1-2/idVendor").write_text("3162\n", "utf-8")
    (tmp_path / "devices/usb1/1-2/idProduct").write_text("0053\n", "utf-8")
    (tmp_path / "class/tty/ttyACM0").mkdir(parents=True)
    (tmp_path / "class/tty/ttyACM0/device").symlink_to(device)
    rule = _rules("/dev/ttyACM0:57600", tmp_path)
    assert 'ATTRS{idVendor}=="3162", ATTRS{idProduct}=="0053", GROUP="dialout"' in rule
    assert "ttyACM0" not in rule
