"""`follower doctor` in real processes, with real packages' metadata, files, sockets and rights."""

from __future__ import annotations

import importlib.abc
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest
from packaging.requirements import Requirement
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.apps.doctor import packages, reading
from follower.apps.doctor.checks import DOCTOR_CHECKS, SETTINGS_CHECKS, examine
from follower.apps.doctor.reading import DeviceFile, Installation
from follower.apps.preflight.check import CameraReading, ComputerReading, PreflightVerdict
from follower.settings.settings import Settings
from follower_vision.models import ModelStore

ROOT = Path(__file__).parents[4]
PASS, WARN, FAIL, UNKNOWN = (
    PreflightVerdict.PASS,
    PreflightVerdict.WARN,
    PreflightVerdict.FAIL,
    PreflightVerdict.UNKNOWN,
)
NOBODY = 65534


def follower(
    home: Path, *arguments: str, path: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the program in a home of its own, with `path` before all other packages."""
    sources = (ROOT, ROOT / "vision", ROOT / "control", ROOT / "sim")
    return subprocess.run(
        [sys.executable, "-m", "follower", *arguments],
        cwd=home,
        env={
            "PATH": os.environ["PATH"],
            "HOME": str(home),
            "PYTHONPATH": os.pathsep.join(map(str, [*([path] if path else []), *sources])),
            **environment,
        },
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


def install(folder: Path, name: str, module: str, *requirements: str) -> None:
    """Put a package's metadata into a folder, as pip does."""
    info = folder / f"{name.replace('-', '_')}-9.0.dist-info"
    info.mkdir(parents=True)
    lines = ["Metadata-Version: 2.1", f"Name: {name}", "Version: 9.0"]
    lines += [f"Requires-Dist: {one}" for one in requirements]
    (info / "METADATA").write_text("\n".join(lines) + "\n", "utf-8")
    (info / "RECORD").write_text(f"{module}/__init__.py,,\n{info.name}/METADATA,,\n", "utf-8")
    (info / "top_level.txt").write_text(f"{module}\n", "utf-8")


def checks_of(ran: subprocess.CompletedProcess[str]) -> dict[str, dict[str, Any]]:
    content = json.loads(ran.stdout)
    assert ran.returncode == (0 if content["ready"] else 1)
    return {check["name"]: check for check in content["checks"]}


@pytest.mark.slow
def test_it_needs_no_vehicle_and_no_settings_and_writes_nothing(tmp_path: Path) -> None:
    ran = follower(tmp_path, "doctor", "--json")
    checks = checks_of(ran)
    assert list(checks) == [check.name for check in DOCTOR_CHECKS]
    assert all(checks[name]["verdict"] == "pass" for name in ("python", "signing-key"))
    assert checks["networks"]["verdict"] == "warn"
    assert checks["networks"]["todo"] == "follower models pull"
    assert {path.name for path in tmp_path.iterdir()} <= {".cache"}, "onnxruntime's own"
    assert ran.stderr == ""


@pytest.mark.slow
def test_packages_that_shadow_one_another_and_a_damaged_network_are_told(tmp_path: Path) -> None:
    home, path, models = (tmp_path / name for name in ("home", "packages", "models"))
    home.mkdir()
    models.mkdir()
    (models / "yolox_nano_bi.onnx").write_bytes(b"half a network")
    plain = [one for one in packages.shared_modules()["onnxruntime"] if one == "onnxruntime"]
    if not plain:
        install(path, "onnxruntime", "onnxruntime")
    install(path, "onnxruntime-zeta", "onnxruntime")
    install(path, "opencv-python", "cv2")
    ran = follower(home, "doctor", path=path, FOLLOWER_MODELS=str(models))
    assert ran.returncode == 1
    (verdict, *lines) = ran.stdout.partition("Something is wrong")[2].splitlines()
    assert verdict.endswith("checks failed")
    told = {line.split(":")[0].strip(): line for line in lines}
    said = told["one-of-each"]
    assert "onnxruntime-zeta shadow one another: each installs the module onnxruntime" in said
    assert "opencv-python-headless shadow one another: each installs the module cv2" in said
    assert "-m pip install onnxruntime-zeta && " in said
    assert said.endswith("pip install opencv-python-headless")
    assert "missing or damaged: yolox_nano_bi.onnx" in told["networks"]
    assert "`follower models pull yolox-nano`" in told["networks"]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["doctor", "--help"])
def test_what_an_uninstalled_onnxruntime_leaves_ends_in_one_line_that_mends_it(
    tmp_path: Path, command: str
) -> None:
    path = tmp_path / "packages"
    (path / "onnxruntime" / "capi").mkdir(parents=True)  # a folder without its files, as pip's
    (path / "onnxruntime" / "__init__.py").touch()
    ran = follower(tmp_path, command, path=path)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.count("\n") == 1
    assert ran.stderr.startswith("follower: module 'onnxruntime' has no attribute")
    assert "-m pip install onnxruntime" in ran.stderr


def test_an_error_that_is_no_packages_fault_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    from follower.__main__ import main

    monkeypatch.setitem(sys.modules, "follower.apps.main", None)
    with pytest.raises(ImportError, match=r"follower\.apps\.main"):
        main()


def test_ctrl_c_while_the_packages_load_ends_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from follower.__main__ import main

    class Interrupted(importlib.abc.MetaPathFinder):
        def find_spec(self, name: str, *_: object) -> None:
            if name == "follower.apps.main":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "follower.apps.main", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    monkeypatch.setattr(sys, "argv", ["follower", "demo"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == ""


def test_requirements_that_are_not_met(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ("numpy<1", "absent-package>=2,<3", "rich>=1", 'torch==0.1; extra == "train"')
    install(tmp_path, "drone-target-follower", "follower", *asked, "onnxruntime>=1.20")
    monkeypatch.syspath_prepend(str(tmp_path))
    unmet = packages.unmet_requirements()
    assert unmet is not None
    assert [str(one) for one in unmet] == ["numpy<1", "absent-package<3,>=2"]
    assert packages.installing(unmet).endswith(" -m pip install 'numpy<1' 'absent-package<3,>=2'")


def test_an_accelerators_onnxruntime_stands_in_for_the_plain_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "drone-target-follower", "follower", "onnxruntime>=1.20")
    install(tmp_path, "onnxruntime-gpu", "onnxruntime")
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert packages.shared_modules() == {"onnxruntime": ("onnxruntime-gpu",), "cv2": ()}
    assert packages.unmet_requirements() == ()
    monkeypatch.setattr(sys, "path", [])
    assert packages.unmet_requirements() is None


def test_settings_are_judged_where_they_are_given(
    run_command: Callable[..., Any], tmp_path: Path
) -> None:
    key = tmp_path / "key"
    key.write_text("a passphrase", "utf-8")
    key.chmod(0o644)
    (tmp_path / "mine.yaml").write_text(
        f"link: {{signing_key_file: {key}}}\ndetector: {tmp_path}/own.onnx\n"
        "recorder: {flight_min: 9}\n",
        "utf-8",
    )
    ended = run_command("doctor", "--json", "-c", "mine.yaml")
    checks = {check["name"]: check for check in json.loads(ended.out)["checks"]}
    assert ended.code == 1
    assert "others may read" in checks["signing-key"]["why"]
    assert checks["models"]["why"] == "own.onnx is missing"
    assert checks["lens"]["verdict"] == "fail"
    assert "for 9 min" in checks["disk"]["why"]
    refused = run_command("doctor", "-c", "nowhere.yaml")
    assert refused.code == 2
    assert refused.err.count("\n") == 1


def test_who_listens_on_the_ground_stations_port_is_named(free_port: Callable[[], int]) -> None:
    port = free_port()
    name = Path("/proc/self/comm").read_text("utf-8").strip()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", port))
        assert reading.heard((port,), 0.0) == (f"{name} listens on UDP {port}",)
    assert reading.heard((port,), 0.0) == ()


def test_heartbeats_are_heard_and_nothing_is_sent(free_port: Callable[[], int]) -> None:
    port, heard, stop = free_port(), [], Event()
    vehicle = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    beats = [
        vehicle.heartbeat_encode(2, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 0).pack(vehicle),
        station.heartbeat_encode(mavlink.MAV_TYPE_GCS, 8, 0, 0, 0).pack(station),
        b"no packet at all",
    ]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        sender.setblocking(False)

        def send() -> None:
            while not stop.wait(0.01):
                for beat in beats:
                    sender.sendto(beat, ("127.0.0.1", port))

        thread = Thread(target=send)
        thread.start()
        try:
            heard = list(reading.heard((port,), 0.5))
        finally:
            stop.set()
            thread.join()
        with pytest.raises(BlockingIOError):
            sender.recv(1)
    assert sorted(heard) == [
        f"ground station 255 sends heartbeats to UDP {port}",
        f"vehicle 7 (px4) sends heartbeats to UDP {port}",
    ]


@pytest.fixture
def computer() -> Iterator[Path]:
    """A computer's file tree that another user may look into."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        root.chmod(0o755)
        for number, (index, name) in enumerate(
            [("0", "HD Webcam"), ("1", "HD Webcam"), ("0", "rp1-cfe-csi2_ch0")]
        ):
            node = root / f"sys/class/video4linux/video{number}"
            node.mkdir(parents=True)
            (node / "index").write_text(f"{index}\n", "utf-8")
            (node / "name").write_text(f"{name}\n", "utf-8")
        (root / "dev/serial/by-id").mkdir(parents=True)
        for name in ("video0", "video1", "video2", "ttyACM0", "ttyAMA0", "ttyAMA10", "ttyS0"):
            (root / "dev" / name).touch(0o600)
        (root / "dev/serial/by-id/usb-Holybro_Pixhawk6C").symlink_to("../../ttyACM0")
        (root / "proc").mkdir()
        (root / "proc/cmdline").write_text("console=ttyAMA10,115200 console=tty1 root=/\n", "utf-8")
        for core, governor in enumerate(("ondemand", "powersave")):
            folder_of = root / f"sys/devices/system/cpu/cpu{core}/cpufreq"
            folder_of.mkdir(parents=True)
            (folder_of / "scaling_governor").write_text(f"{governor}\n", "utf-8")
        (folder_of / "scaling_driver").write_text("intel_pstate\n", "utf-8")
        yield root


@contextmanager
def without_rights() -> Iterator[None]:
    """Be a user without rights for a while, where this is root."""
    if os.geteuid() != 0:
        yield
        return
    groups = os.getgroups()
    os.setgroups([])
    os.setresgid(NOBODY, NOBODY, 0)
    os.setresuid(NOBODY, NOBODY, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)
        os.setresgid(0, 0, 0)
        os.setgroups(groups)


def test_cameras_and_ports_are_listed_with_their_names_and_rights(computer: Path) -> None:
    assert [(one.path.name, one.label) for one in reading.cameras(computer)] == [
        ("video0", "HD Webcam"),
        ("video2", "rp1-cfe-csi2_ch0"),
    ]
    assert [(one.path.name, one.label) for one in reading.serial_ports(computer)] == [
        ("ttyACM0", "usb-Holybro_Pixhawk6C"),
        ("ttyAMA0", ""),
        ("ttyAMA10", ""),
    ]
    assert list(reading.consoles(computer)) == ["ttyAMA10", "tty1"]
    assert reading.governors(computer) == {"ondemand", "powersave of intel_pstate"}
    if os.geteuid() != 0:
        for path in (computer / "dev").glob("*"):
            path.chmod(0o755 if path.is_dir() else 0)
    with without_rights():
        ports, cameras = reading.serial_ports(computer), reading.cameras(computer)
        assert [one.usable for one in (*ports, *cameras)] == [False] * 5


def test_an_empty_computer_has_nothing(tmp_path: Path) -> None:
    assert [*reading.cameras(tmp_path), *reading.serial_ports(tmp_path)] == []
    assert [*reading.consoles(tmp_path), *reading.governors(tmp_path)] == []
    assert reading.udp_owner(14550, tmp_path) == ""


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone becomes another user")
def test_a_user_outside_the_groups_is_told_apart_from_root() -> None:
    there = reading.memberships(("dialout", "no-such-group"))
    assert set(there.values()) <= {True}
    assert "no-such-group" not in there
    with without_rights():
        assert set(reading.memberships(("dialout",)).values()) <= {False}


def test_where_networks_run_is_tried_with_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = ModelStore(tmp_path)
    assert reading.tried_device(store, "cpu") == ("cpu", {})
    device, refusals = reading.tried_device(store, "cann")
    assert device == "cpu"
    assert "has no cann" in refusals["cann"]
    assert caplog.messages == [], "the table says it"
    lost = ModelStore(tmp_path, embedded=tmp_path)
    assert reading.tried_device(lost, "cpu") == ("cpu", {})
    assert "install it again" in reading.broken_files(lost)["follower-detector.onnx"]


def healthy() -> Installation:
    camera = DeviceFile(Path("/dev/video0"), "HD Webcam", usable=True)
    return Installation(
        settings=Settings.model_validate({"camera": {"fov_deg": 70.0}}),
        camera=CameraReading(size=(640, 480)),
        computer=ComputerReading(int(60e9), "runs", 55.0, 0, 0.3),
        shared={"onnxruntime": ("onnxruntime",), "cv2": ("opencv-python-headless",)},
        refusals={},
        broken={},
        cameras=(camera,),
        ports=(DeviceFile(Path("/dev/ttyACM0"), "", usable=True),),
        groups={"dialout": True, "video": True},
        clock_is_set=True,
        governors=frozenset({"ondemand"}),
        heard=("QGroundControl listens on UDP 14550",),
    )


def on(device: str) -> Settings:
    return Settings.model_validate({"vision": {"device": device}})


def files(name: str, *labels: str, usable: bool) -> tuple[DeviceFile, ...]:
    return tuple(DeviceFile(Path(f"/dev/{name}"), label, usable) for label in labels)


CASES: list[tuple[str, dict[str, Any], PreflightVerdict, str, str]] = [
    ("packages", {"unmet": None}, WARN, "sources", "pip install ."),
    ("packages", {"unmet": (Requirement("numpy<1"),)}, FAIL, "numpy<1", "pip install 'numpy<1'"),
    ("one-of-each", {"shared": {"cv2": ("a", "b")}}, FAIL, "a and b", "uninstall -y a b"),
    ("accelerator", {"gpu": Path("/dev/nvidia0")}, WARN, "/dev/nvidia0", "onnxruntime-gpu"),
    ("accelerator", {"gpu": Path("/dev/nvidia0"), "settings": on("cpu")}, PASS, "cpu", ""),
    ("accelerator", {"refusals": {"cuda": "does not start"}}, PASS, "not on cuda", ""),
    (
        "accelerator",
        {"refusals": {"cuda": "does not start"}, "settings": on("cuda")},
        WARN,
        "not on cuda",
        "driver",
    ),
    ("networks", {"broken": {"a.onnx": "pull a"}}, FAIL, "a.onnx", "pull a"),
    ("networks", {"unfetched": ("yolox-nano",)}, WARN, "yolox-nano", "models pull"),
    ("cameras", {"cameras": ()}, WARN, "none", "plug it in"),
    ("cameras", {"cameras": files("video0", "rp1-cfe-1", usable=True)}, WARN, "raw", "stream"),
    ("cameras", {"cameras": files("video0", "Cam", usable=False)}, FAIL, "video0", "usermod"),
    ("serial-ports", {"ports": ()}, WARN, "none", "uart0"),
    ("serial-ports", {"ports": files("ttyUSB0", "", usable=False)}, FAIL, "ttyUSB0", "dialout"),
    ("serial-ports", {"consoles": ("ttyACM0",)}, WARN, "console", "raspi-config"),
    ("groups", {"groups": {"video": False}}, WARN, "not in video", "usermod -aG video $USER"),
    ("groups", {"groups": {"video": None}}, WARN, "not in this login", "log in again"),
    ("groups", {"groups": {}}, PASS, "neither", ""),
    ("ground-station", {"heard": ()}, UNKNOWN, "cannot be seen from here", "QGroundControl"),
    ("clock", {"clock_is_set": False}, WARN, "not synchronised", "timedatectl"),
    ("clock", {"clock_is_set": None}, UNKNOWN, "kernel", ""),
    ("governor", {"governors": {"powersave"}}, WARN, "powersave", "tee /sys/devices"),
    ("governor", {"governors": {"powersave of intel_pstate"}}, PASS, "powersave", ""),
    ("governor", {"governors": frozenset()}, UNKNOWN, "not report", ""),
    (
        "throttling",
        {"computer": ComputerReading(10**11, throttled=0x4)},
        FAIL,
        "slowed down",
        "cool",
    ),
    ("disk", {"computer": ComputerReading(free_bytes=10**8)}, FAIL, "0.1 GB", "delete"),
    ("lens", {"lens_given": False}, FAIL, "neither", "calibrate"),
]


def test_a_healthy_computer_has_no_findings() -> None:
    results = examine(healthy(), own_settings=True)
    assert [(r.check.name, r.finding) for r in results if r.finding.verdict is not PASS] == []
    names = [check.name for check in (*DOCTOR_CHECKS, *SETTINGS_CHECKS)]
    assert [result.check.name for result in results] == names
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("name", "change", "verdict", "why", "todo"), CASES, ids=lambda v: v if type(v) is str else ""
)
def test_each_finding_says_what_is_wrong_and_what_to_type(
    name: str, change: dict[str, Any], verdict: PreflightVerdict, why: str, todo: str
) -> None:
    results = examine(replace(healthy(), **change), own_settings=True)
    (found,) = (result for result in results if result.check.name == name)
    assert found.finding.verdict is verdict
    assert why in found.finding.why
    assert todo in found.finding.todo
    assert [r.check.name for r in results if r.refuses and r is not found] == []
