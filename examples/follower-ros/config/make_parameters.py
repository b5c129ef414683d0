"""Writes follower.yaml, every setting as a parameter with its default, and large_images.xml."""

from pathlib import Path

import yaml

from follower.apps.ros.conversion import flat_settings
from follower.settings.settings import Settings, configs_folder


def text() -> str:
    """Return the file's content."""
    content = {"/**": {"ros__parameters": flat_settings(Settings())}}
    said = (
        "# By make_parameters.py: all settings, for any name of the node; see `follower settings`."
    )
    return f"{said}\n{yaml.safe_dump(content, sort_keys=False)}"


if __name__ == "__main__":
    folder = Path(__file__).parent
    (folder / "follower.yaml").write_text(text(), "utf-8")
    profile = configs_folder() / "ros" / "large_images.xml"
    (folder / profile.name).write_bytes(profile.read_bytes())
