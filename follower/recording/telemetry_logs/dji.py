"""Telemetry in subtitles (.SRT), as drones of DJI and Autel write it beside their videos."""

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples

_LONGEST = 4096
"""Of a line, and of a cue's text, in characters: nothing that we read is longer."""
_CUE = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{3})\s*-->")
_NUMBER = r"[-+]?\d{1,12}(?:\.\d{1,12})?"
_PAIR = re.compile(r"([A-Za-z_]+)\s*:\s*([-+]?\d{1,12}(?:[.,]\d{1,12})?)")
_PLACE = re.compile(r"\b(?:GPS|RTK)\s*\(([^)]*)\)")
_PART = re.compile(rf"([NSEW])?\s*:?\s*({_NUMBER})\s*(m)?", re.IGNORECASE)
_ANGLES = re.compile(rf"\b([FG])\.PRY\s*\(({_NUMBER})\D*?({_NUMBER})\D*?({_NUMBER})")
_HEIGHT = re.compile(rf"\bH\s+({_NUMBER})\s*m", re.IGNORECASE)
_SIGNS = re.compile(r"\b(?:GPS|RTK)\s*\(|\b(?:latitude|rel_alt|gb_yaw)\s*:")
_HALF_DIAGONAL_MM = math.hypot(36, 24) / 2
_WIDE = 16 / math.hypot(16, 9)


def is_drone_srt(head: str) -> bool:
    """Whether a file that begins like this is subtitles with telemetry in them."""
    return bool(_CUE.search(head) and _SIGNS.search(head))


def read_srt(path: Path) -> TelemetrySamples:
    """Read subtitles: position, height; aircraft's and gimbal's angles and the lens, if given.

    Times are the subtitles', so the video's. Known are the lines of Mavic Pro, Phantom 4 RTK,
    Matrice 300 (GPS and HOME in parentheses), Mavic 2, Mini, Air, Mavic 3, Matrice 30 (brackets),
    and Autel Evo. A gimbal without the aircraft's angles: the aircraft is taken to be level, and to
    point where the camera does.

    Raises:
        TelemetryError: no cue has a position.
        OSError: it cannot be read.
    """
    samples = TelemetrySamples(on_video_clock=True, gimbal_from_north=True)
    ground_m: float | None = None
    for time_s, text in _cues(path):
        values = _values(text)
        place = _place(text, values)
        if place is not None:
            height_m = _first(values, "rel_alt", "barometer", "hb", "h")
            if height_m is None:  # above the sea, or whatever: counted from the first
                absolute_m = place[2]
                ground_m = absolute_m if ground_m is None else ground_m
                height_m = absolute_m - ground_m
            samples.add_fix(time_s, place[0], place[1], height_m)
        _take_angles(samples, time_s, values)
        if samples.fov_deg is None and "focal_len" in values:
            samples.fov_deg = _fov_deg(values)
    if not samples.places:
        raise TelemetryError(f"{path}: no position of a drone of DJI or Autel in these subtitles")
    return samples


def _cues(path: Path) -> Iterator[tuple[float, str]]:
    """Yield each cue's beginning in seconds and its text; one that is cut off is left out.

    The text ends with the next cue: in some dialects there are empty lines in it.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        began_s, text, line = math.nan, "", ""
        while line := file.readline(_LONGEST):
            cue = _CUE.search(line)
            if cue is None:
                text = (text + line)[:_LONGEST]
                continue
            if math.isfinite(began_s):
                yield began_s, text
            hours, minutes, seconds, milliseconds = (int(part[:6]) for part in cue.groups())
            began_s, text = 3600 * hours + 60 * minutes + seconds + milliseconds / 1000, ""
        if math.isfinite(began_s) and text.endswith("\n"):
            yield began_s, text


def _values(text: str) -> dict[str, float]:
    """Return all that a cue says as `name: number`, names in small letters."""
    pairs = ((name.lower(), number) for name, number in _PAIR.findall(text))
    values = {name: float(number.replace(",", ".")) for name, number in pairs}
    if "focal_len" in values and re.search(r"\bfocal_len\s*:\s*\d+\b(?![.,]\d)", text):
        values["focal_len"] /= 10  # without a point it is in tenths of a millimetre
    if height := _HEIGHT.search(text):
        values["h"] = float(height[1])
    for who, *angles in _ANGLES.findall(text):
        prefix = "drone" if who == "F" else "gb"
        names = (f"{prefix}_{axis}" for axis in ("pitch", "roll", "yaw"))
        values |= zip(names, map(float, angles), strict=True)
    return values


def _first(values: Mapping[str, float], *names: str) -> float | None:
    return next((values[name] for name in names if name in values), None)


def _place(text: str, values: Mapping[str, float]) -> tuple[float, float, float] | None:
    """Return latitude, longitude (degrees) and absolute height (m); None without a fix."""
    found = _PLACE.search(text)
    if found:
        place = _listed_place(found[1])
    else:
        longitude = _first(values, "longitude", "longtitude")
        latitude = values.get("latitude")
        if latitude is None or longitude is None:
            return None
        if "longtitude" in values and abs(latitude) < math.pi / 2 and abs(longitude) < math.pi:
            # So some Mavics write radians; in degrees that is the sea off West Africa.
            latitude, longitude = math.degrees(latitude), math.degrees(longitude)
        place = latitude, longitude, _first(values, "abs_alt", "altitude") or 0.0
    return None if place is None or place[:2] == (0.0, 0.0) else place


def _listed_place(inside: str) -> tuple[float, float, float] | None:
    """Return the same of what stands in GPS(...) or RTK(...).

    Autel names the directions. DJI writes longitude, latitude, satellites; where the third is
    metres (Matrice 300) latitude comes first.
    """
    parts = [(side.upper(), float(number), unit) for side, number, unit in _PART.findall(inside)]
    if len(parts) < 2:
        return None
    height_m = parts[2][1] if len(parts) > 2 and parts[2][2] else 0.0
    named = {side: -number if side in "SW" else number for side, number, _ in parts[:2] if side}
    if named:
        latitude, longitude = named.get("N", named.get("S")), named.get("E", named.get("W"))
        return None if latitude is None or longitude is None else (latitude, longitude, height_m)
    longitude, latitude = parts[0][1], parts[1][1]
    if len(parts) > 2 and parts[2][2]:
        longitude, latitude = latitude, longitude
    return latitude, longitude, height_m


def _take_angles(samples: TelemetrySamples, time_s: float, values: Mapping[str, float]) -> None:
    for prefix, rows in (("gb", samples.gimbals), ("drone", samples.attitudes)):
        names = [f"{prefix}_{axis}" for axis in ("roll", "pitch", "yaw")]
        if all(name in values for name in names):
            rows.append((time_s, *(math.radians(values[name]) for name in names)))
    if "gb_yaw" in values and "drone_yaw" not in values:
        samples.attitudes.append((time_s, 0.0, 0.0, math.radians(values["gb_yaw"])))


def _fov_deg(values: Mapping[str, float]) -> float | None:
    """Return the horizontal field of view of a lens given as of a 35 mm camera, zoom included."""
    zoom = values.get("dzoom") or values.get("dzoom_ratio", 1.0)
    # Some drones write 1.00 for what is 10000 with others.
    focal_mm = values["focal_len"] * (zoom if zoom < 1000 else zoom / 10_000)
    if not focal_mm > 0:
        return None
    return math.degrees(2 * math.atan(_HALF_DIAGONAL_MM * _WIDE / focal_mm))
