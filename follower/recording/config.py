"""`config.yaml`: what a flight was flown with, so that it can be replayed."""

from __future__ import annotations

import platform
import re
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import TypeAdapter, ValidationError
from threadpoolctl import threadpool_info

from follower.flight.vision.tracker_factory import network_files
from follower.recording.mcap_writer import FORMAT
from follower.settings.settings import Settings
from follower_vision.clock import Clock
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.models.download import sha256_of
from follower_vision.sources.capture import without_password

OWN = "drone-target-follower"
_PACKAGES = (OWN, "numpy", "opencv-python-headless", "onnxruntime", "filterpy", "av")
INLINE, RECORDED = "inline", "recorded"
"""What a `run` calls detection that a replay does anew, and one whose answers are in the log."""
_UNNAMED = "the recording does not name its processor"


def late_detection(settings: Settings) -> str:
    """Return what a `run` calls detection in its own time; the paper's Fusion records none."""
    return RECORDED if settings.fusion.algorithm == "fitted" else "background"


def running_versions() -> dict[str, str]:
    """Return the versions of what computes: the same ones give the same flight."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    found["system"] = sys.platform
    found["libc"] = " ".join(platform.libc_ver()).strip() or "unknown"
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def running_processor() -> dict[str, str]:
    """Return the processor's model, the features by which NumPy chooses, and its BLAS' kernels."""
    libraries = [one for one in threadpool_info() if "numpy" in one.get("filepath", "")]
    kernels = {str(one["architecture"]) for one in libraries if one.get("architecture")}
    return {
        "model": _model(),
        "features": " ".join(processor_features()),
        "blas": " ".join(sorted(kernels)),
    }


def processor_features() -> list[str]:
    """Return the instruction sets that NumPy was built for and those that it found besides."""
    known = np.show_config(mode="dicts").get("SIMD Extensions", {})
    return [*known.get("baseline", ()), *known.get("found", ())]


def machine_differences(versions: Mapping[str, str], processor: Mapping[str, str]) -> list[str]:
    """Return in words why numbers of a recording may be others here in their last bits; [] if not.

    Args:
        versions: as recorded.
        processor: as recorded; empty in recordings from before it was.
    """
    if not processor:
        return [_UNNAMED]
    now = running_processor()
    kinds = [
        f"processor {name} {now[name] or 'none'}, recorded with {processor.get(name) or 'none'}"
        for name in ("features", "blas")
        if processor.get(name, "") != now[name]
    ]
    return kinds + changed_versions({k: v for k, v in versions.items() if k != OWN})


def changed_versions(recorded: Mapping[str, str]) -> list[str]:
    """Return in words which versions are others today."""
    now = running_versions()
    names = [name for name in now if name in recorded and recorded[name] != now[name]]
    return [f"{name} {now[name]}, recorded with {recorded[name]}" for name in names]


def _model() -> str:
    """Return the processor's name, or that of a board whose processor has none."""
    info: dict[str, str] = {}
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
        parts = (line.partition(":") for line in lines)
        info = {name.strip(): value.strip() for name, _, value in parts}
    return info.get("model name") or info.get("Model") or platform.processor() or platform.machine()


LOCKSTEP_EPOCH_NS = 946_684_800 * 10**9
"""Lockstep flights begin with the year 2000, so that the same flight is the same log."""

_SECRET = re.compile(r"secret|password|passphrase|passwd|token|signing_key|private|credential")


@dataclass(frozen=True, slots=True)
class FlightConfig:
    """What a flight was flown with.

    Attributes:
        kind: "simulated", "real" or "video": recorded or live video without a flight.
        settings: as resolved, in the form of the settings' YAML.
        run: what was run: scenario, autopilot, seed, source, command.
        camera: intrinsics, where they are not those of the settings.
        needs_telemetry: False if control ran on the image alone.
        epoch_ns: the flight's time 0 in nanoseconds since 1970, UTC.
        versions: of this program, Python, the C library and the packages that compute.
        processor: its model, the features by which NumPy chooses its code, its BLAS' kernels;
            empty in older recordings.
        models: SHA-256 of each network's file.
        format: of the recording.
    """

    kind: str
    settings: dict[str, Any]
    run: dict[str, Any] = field(default_factory=dict)
    camera: CameraModel | None = None
    needs_telemetry: bool = True
    epoch_ns: int = LOCKSTEP_EPOCH_NS
    versions: dict[str, str] = field(default_factory=dict)
    models: dict[str, str] = field(default_factory=dict)
    format: int = FORMAT
    processor: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        kind: str,
        settings: Settings,
        *,
        run: Mapping[str, Any] | None = None,
        camera: CameraModel | None = None,
        needs_telemetry: bool = True,
        epoch_ns: int = LOCKSTEP_EPOCH_NS,
    ) -> FlightConfig:
        """Describe a flight that begins now, with the versions that are running."""
        return cls(
            kind,
            settings.model_dump(mode="json"),
            dict(run or {}),
            camera,
            needs_telemetry,
            epoch_ns,
            running_versions(),
            model_hashes(settings),
            processor=running_processor(),
        )

    def group(self, name: str) -> Mapping[str, Any]:
        """Return a group of the settings; {} if there is none, or something else in its place."""
        found = self.settings.get(name)
        return found if isinstance(found, dict) else {}

    def number(self, group: str, name: str) -> float | None:
        """Return a setting that is a number; None if there is none, or something else."""
        found = self.group(group).get(name)
        return found if type(found) in (int, float) else None

    def to_yaml(self) -> str:
        """Return the file's text; nothing secret is in it."""
        plain = _WHOLE.dump_python(self, mode="json")
        plain["settings"] = plain.pop("settings")  # it is long: the file's last part
        return yaml.safe_dump(without_secrets(plain), sort_keys=False, allow_unicode=True)

    @classmethod
    def from_yaml(cls, text: str) -> FlightConfig:
        """Read the file's text.

        Raises:
            ValueError: it is not of this form.
        """
        try:
            config = _WHOLE.validate_python(yaml.safe_load(text))
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            where = ".".join(map(str, first["loc"]))
            raise ValueError(f"not a flight's configuration ({where}: {first['msg']})") from error
        except (yaml.YAMLError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"not a flight's configuration ({reason})") from error
        if config.format > FORMAT:
            raise ValueError(f"not a flight's configuration (of format {config.format})")
        return config


_WHOLE = TypeAdapter(FlightConfig)


def epoch_now_ns(clock: Clock) -> int:
    """Return what the clock's 0 is in nanoseconds since 1970, UTC.

    Nothing else asks for the calendar's time, and nothing is decided by it: it dates the log.
    """
    return time.time_ns() - round(clock.now() * 1e9)


def model_hashes(settings: Settings) -> dict[str, str]:
    """Return the SHA-256 of the networks' files, and of a fitted model of Fusion's, by name."""
    files = network_files(settings)
    if settings.fusion.model is not None:
        files.append(Path(settings.fusion.model))
    return {path.name: sha256_of(path) for path in files if path.is_file()}


def without_secrets(plain: Any) -> Any:
    """Return the same without keys that name a secret, and without log-ins in addresses."""
    if isinstance(plain, dict):
        kept = {key: value for key, value in plain.items() if not _SECRET.search(str(key).lower())}
        return {key: without_secrets(value) for key, value in kept.items()}
    if isinstance(plain, list | tuple):
        return [without_secrets(value) for value in plain]
    if not isinstance(plain, str):
        return plain
    return without_password(plain)
