"""Writes follower.yaml: every parameter of the node with its default, from the settings."""

from pathlib import Path

import yaml

from follower.apps.ros.conversion import flat_settings
from follower.settings.settings import Settings


def text() -> str:
    """Return the file's content."""
    content = {"follower": {"ros__parameters": flat_settings(Settings())}}
    return "# By make_parameters.py: all settings; see `follower settings`.\n" + yaml.safe_dump(
        content, sort_keys=False
    )


if __name__ == "__main__":
    (Path(__file__).parent / "follower.yaml").write_text(text(), "utf-8")
