"""Starts `follower ros`."""

import sys

from follower.apps.main import main as follower


def main() -> None:
    """Be the node; options and `--ros-args` as `follower ros` takes them."""
    sys.argv.insert(1, "ros")
    follower()
