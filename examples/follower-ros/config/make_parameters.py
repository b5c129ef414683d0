"""Writes follower.yaml, every parameter of the node with its default, and large_images.xml."""

from pathlib import Path

import yaml

from follower.apps.ros.conversion import flat_settings
from follower.settings.settings import Settings, configs_folder


def text() -> str:
    """Return the file's content."""
    content = {"follower": {"ros__parameters": flat_settings(Settings())}}
    return "# By make_parameters.py: all settings; see `follower settings`.\n" + yaml.safe_dump(
        content, sort_keys=False
    )


if __name__ == "__main__":
    folder = Path(__file__).parent
    (folder / "follower.yaml").write_text(text(), "utf-8")
    profile = configs_folder() / "ros" / "large_images.xml"
    (folder / profile.name).write_bytes(profile.read_bytes())
