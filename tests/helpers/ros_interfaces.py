"""Builds messages of ROS that are not on PyPI, from their definitions, with the real generators.

The fields are those of mavros_msgs 2, vision_msgs 4 and tf2_msgs; constants are left out, which
changes nothing on the wire. It takes a C++ compiler and about half a minute.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

MESSAGES = {
    "mavros_msgs": {
        "msg/State": (
            "std_msgs/Header header; bool connected; bool armed; bool guided; bool manual_input; "
            "string mode; uint8 system_status"
        ),
        "msg/ExtendedState": "std_msgs/Header header; uint8 vtol_state; uint8 landed_state",
        "msg/RCIn": "std_msgs/Header header; uint8 rssi; uint16[] channels",
        "msg/PositionTarget": (
            "std_msgs/Header header; uint8 coordinate_frame; uint16 type_mask; "
            "geometry_msgs/Point position; geometry_msgs/Vector3 velocity; geometry_msgs/Vector3 "
            "acceleration_or_force; float32 yaw; float32 yaw_rate"
        ),
        "msg/SysStatus": (
            "std_msgs/Header header; uint32 sensors_present; uint32 sensors_enabled; uint32 "
            "sensors_health; uint16 load; uint16 voltage_battery; int16 current_battery; int8 "
            "battery_remaining; uint16 drop_rate_comm; uint16 errors_comm; uint16 errors_count1; "
            "uint16 errors_count2; uint16 errors_count3; uint16 errors_count4"
        ),
        "msg/EstimatorStatus": (
            "std_msgs/Header header; bool attitude_status_flag; bool velocity_horiz_status_flag; "
            "bool velocity_vert_status_flag; bool pos_horiz_rel_status_flag; bool "
            "pos_horiz_abs_status_flag; bool pos_vert_abs_status_flag; bool "
            "pos_vert_agl_status_flag; bool const_pos_mode_status_flag; bool "
            "pred_pos_horiz_rel_status_flag; bool pred_pos_horiz_abs_status_flag; bool "
            "gps_glitch_status_flag; bool accel_error_status_flag"
        ),
        "msg/GPSRAW": (
            "std_msgs/Header header; uint8 fix_type; int32 lat; int32 lon; int32 alt; uint16 eph; "
            "uint16 epv; uint16 vel; uint16 cog; uint8 satellites_visible; int32 alt_ellipsoid; "
            "uint32 h_acc; uint32 v_acc; uint32 vel_acc; int32 hdg_acc; uint16 yaw; uint8 "
            "dgps_numch; uint32 dgps_age"
        ),
        "msg/Altitude": (
            "std_msgs/Header header; float32 monotonic; float32 amsl; float32 local; float32 "
            "relative; float32 terrain; float32 bottom_clearance"
        ),
        "msg/StatusText": "std_msgs/Header header; uint8 severity; string text",
        "msg/VehicleInfo": (
            "std_msgs/Header header; uint8 available_info; uint8 sysid; uint8 compid; uint8 "
            "autopilot; uint8 type; uint8 system_status; uint8 base_mode; uint32 custom_mode; "
            "string mode; uint32 mode_id; uint64 capabilities; uint32 flight_sw_version; uint32 "
            "middleware_sw_version; uint32 os_sw_version; uint32 board_version; string "
            "flight_custom_version; uint16 vendor_id; uint16 product_id; uint64 uid"
        ),
        "srv/CommandLong": (
            "bool broadcast; uint16 command; uint8 confirmation; float32 param1; float32 param2; "
            "float32 param3; float32 param4; float32 param5; float32 param6; float32 param7; ---; "
            "bool success; uint8 result"
        ),
        "srv/VehicleInfoGet": (
            "uint8 sysid; uint8 compid; bool get_all; ---; bool success; "
            "mavros_msgs/VehicleInfo[] vehicles"
        ),
    },
    "vision_msgs": {
        "msg/Point2D": "float64 x; float64 y",
        "msg/Pose2D": "vision_msgs/Point2D position; float64 theta",
        "msg/BoundingBox2D": "vision_msgs/Pose2D center; float64 size_x; float64 size_y",
        "msg/ObjectHypothesis": "string class_id; float64 score",
        "msg/ObjectHypothesisWithPose": (
            "ObjectHypothesis hypothesis; geometry_msgs/PoseWithCovariance pose"
        ),
        "msg/Detection2D": (
            "std_msgs/Header header; ObjectHypothesisWithPose[] results; BoundingBox2D bbox; "
            "string id"
        ),
        "msg/Detection2DArray": "std_msgs/Header header; Detection2D[] detections",
    },
    "tf2_msgs": {"msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"},
}
"""By package and file; a semicolon ends a line."""

_USED = ("std_msgs", "geometry_msgs", "builtin_interfaces", "service_msgs")
_GENERATE = """
import sys, logging
from importlib.metadata import entry_points
from pathlib import Path
import rosidl_cli.command.generate.api as api
import rosidl_cli.entry_points as found, rosidl_cli.extensions as extensions
def once(group, *, specs=None, strict=False):  # the wheels name each generator twice
    return {e.name: e for e in entry_points(group=group) if specs is None or e.name in specs}
found.get_entry_points = extensions.get_entry_points = once
package, root, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
files = [f"{root}:{p.relative_to(root)}" for p in sorted(root.rglob("*.*"))]
api.generate(package_name=package, interface_files=files,
    include_paths=[sys.prefix + "/share"], output_path=out, types=["c", "py"],
    typesupports=["c", "fastrtps_c", "introspection_c"])
"""


def build(folder: Path) -> Path:
    """Build all packages; return what has to be on PYTHONPATH and LD_LIBRARY_PATH."""
    if shutil.which("g++") is None:
        pytest.skip("builds ROS messages, which needs g++")
    pytest.importorskip("catkin_pkg", reason="builds ROS messages, by catkin_pkg: make ros")
    site = folder / "site"
    for package, definitions in MESSAGES.items():
        root = folder / package
        for name, text in definitions.items():
            kind = name.partition("/")[0]
            path = (root / name).with_suffix(f".{kind}")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text.replace("; ", "\n").replace(";", "\n") + "\n")
        _build(package, root, folder / f"{package}-out", site)
    return site


def _build(package: str, root: Path, out: Path, site: Path) -> None:
    environment = {**os.environ, "AMENT_PREFIX_PATH": sys.prefix}
    command = [sys.executable, "-c", _GENERATE, package, str(root), str(out)]
    subprocess.run(command, check=True, env=environment, capture_output=True)
    headers, introspection = out / "include", out / "introspection"
    for source, target in (
        ("c", headers),
        ("fastrtps_c", headers),
        ("introspection_c", introspection),
    ):
        shutil.copytree(out / source, target / package, dirs_exist_ok=True)
    shutil.copytree(out / "py", site / package, dirs_exist_ok=True)
    (site / package / "__init__.py").touch()
    prefix, used = Path(sys.prefix), [headers, introspection, Path(sys.prefix) / "include"]
    used += [*(prefix / "include").iterdir(), Path(sysconfig.get_paths()["include"])]
    import numpy

    flags = [f"-I{path}" for path in (*used, numpy.get_include())]
    flags += ["-O0", "-w", "-fPIC", "-shared", f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib"]

    def libraries(kind: str) -> list[str]:
        return [f"-l{one}__rosidl_{kind}" for one in _USED]

    def compiler(
        tool: str, name: str, sources: list[Path], more: list[str]
    ) -> subprocess.Popen[bytes]:
        target = ["-o", str(site / name), *map(str, sources), *more]
        return subprocess.Popen([tool, *flags, *target])

    def of(folder: Path, *patterns: str) -> list[Path]:
        return [path for pattern in patterns for path in (folder / package).glob(pattern)]

    detail = ("*/detail/*__functions.c", "*/detail/*__description.c", "*/detail/*__type_support.c")
    fast = ["-lfastcdr", "-lrosidl_typesupport_fastrtps_c", "-lrosidl_typesupport_fastrtps_cpp"]
    running = [
        compiler(
            "gcc",
            f"lib{package}__rosidl_generator_c.so",
            [*of(headers, *detail), *(site / package).glob("*/*_s.c")],
            [
                *libraries("generator_c"),
                *libraries("generator_py"),
                "-lrosidl_runtime_c",
                "-lrcutils",
            ],
        ),
        compiler(
            "g++",
            f"lib{package}__rosidl_typesupport_fastrtps_c.so",
            of(headers, "*/detail/*__type_support_c.cpp", "*/*__type_support.cpp"),
            [*libraries("typesupport_fastrtps_c"), *fast, "-lrosidl_typesupport_c", "-lrmw"],
        ),
    ]
    assert [process.wait() for process in running] == [0, 0]
    ours = [f"-L{site}", f"-Wl,-rpath,{site}", f"-l{package}__rosidl_generator_c"]
    ours.append(f"-l{package}__rosidl_typesupport_fastrtps_c")
    name = f"lib{package}__rosidl_typesupport_introspection_c.so"
    more = [*ours, *libraries("typesupport_introspection_c")]
    sources = of(introspection, "*/detail/*__type_support.c")
    assert compiler("gcc", name, sources, more).wait() == 0
    module = f"{package}/{package}_s__rosidl_typesupport_c.so"
    entry = site / package / f"_{package}_s.ep.rosidl_typesupport_c.c"
    assert compiler("gcc", module, [entry], ours).wait() == 0
