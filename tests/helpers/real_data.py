"""The real data: recorded sequences, the networks' weights, recordings of real autopilots."""

import os
from pathlib import Path

import pytest

_SHARED = Path(__file__).parents[3] / "shared" / "data"
DATA = Path(os.environ.get("FOLLOWER_DATA", _SHARED)).resolve()


def needs_data(*parts: str) -> pytest.MarkDecorator:
    """Skip a test where one of these files or folders of the data is missing."""
    return pytest.mark.skipif(
        not all((DATA / part).exists() for part in parts),
        reason="no real data: put it in ../shared/data or name its folder in FOLLOWER_DATA",
    )
