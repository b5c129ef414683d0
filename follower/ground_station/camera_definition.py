"""The camera definition file: the parameters with their meanings, for a ground station's page.

See https://mavlink.io/en/services/camera_def.html. Names, meanings and choices come from the same
table and docstrings as everything else.
"""

from __future__ import annotations

import inspect
import typing
import zlib
from enum import Enum
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from follower.ground_station.parameter_table import NONE, Parameter, parameters
from follower.recorder.fields import meanings, unit_of
from follower.settings import Settings

PATH = "/camera.xml"
VERSION = 1


def definition_xml(settings: Settings) -> bytes:
    """Return the file; defaults are what the flight begins with."""
    root = Element("mavlinkcamera")
    described = SubElement(root, "definition", version=str(VERSION))
    SubElement(described, "model").text = "tracking camera"
    SubElement(described, "vendor").text = "follower"
    rows = SubElement(root, "parameters")
    for one in parameters():
        rows.append(_row(one, settings))
    indent(root)
    data: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    return data


def definition_version(data: bytes) -> int:
    """Return a version that differs where the file does: ground stations keep what they had."""
    return zlib.crc32(data) & 0xFFFF or 1


def _row(one: Parameter, settings: Settings) -> Element:
    number = one.number(settings)
    row = Element("parameter", name=one.name, type="float", default=f"{number:.9g}")
    unit = unit_of(one.live.key.rpartition(".")[2])
    SubElement(row, "description").text = one.live.key + (f" ({unit})" if unit else "")
    says = _meaning(one.live.key)
    if one.live.optional:
        says += f" {NONE:g} stands for none."
    if says:
        row.set("tooltip", says)
    if one.members:
        options = SubElement(row, "options")
        for index, member in enumerate(one.members):
            name = str(member.value if isinstance(member, Enum) else member).lower()
            SubElement(options, "option", name=name, value=str(index))
    return row


def _meaning(key: str) -> str:
    """Return what the docstring of the settings says about a key."""
    section, *others = key.split(".")
    law: typing.Any = Settings.model_fields[section].annotation
    for part in others[:-1]:
        law = typing.get_type_hints(law)[part]
    return meanings(inspect.getdoc(law) or "").get(others[-1], "")
