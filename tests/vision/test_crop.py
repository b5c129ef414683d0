"""A crop shows what its region names, to a fraction of a pixel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop


def blob(cx: float, cy: float) -> np.ndarray:
    """A soft round spot about a point, in pixels from the image's corner."""
    across, down = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    spot = 255 * np.exp(-((across - cx) ** 2 + (down - cy) ** 2) / (2 * 4.0**2))
    return np.repeat(spot[..., None], 3, axis=2).round().astype(np.uint8)


def centre_of(image: np.ndarray) -> tuple[float, float]:
    weight = image[..., 0].astype(float)
    across, down = np.meshgrid(np.arange(image.shape[1]) + 0.5, np.arange(image.shape[0]) + 0.5)
    return (across * weight).sum() / weight.sum(), (down * weight).sum() / weight.sum()


@given(
    st.floats(60, 100),
    st.floats(50, 70),
    st.floats(-10, 10),
    st.floats(-10, 10),
    st.floats(50, 130),
    st.floats(50, 130),
)
def test_a_point_lands_where_the_region_puts_it(
    cx: float, cy: float, dx: float, dy: float, width: float, height: float
) -> None:
    region = Box(cx + dx, cy + dy, width, height)
    seen = centre_of(crop(blob(cx, cy), region, 100, 80, (0, 0, 0)))
    expected = (cx - region.left) / width * 100, (cy - region.top) / height * 80
    assert seen == pytest.approx(expected, abs=0.15)


def test_whole_image_at_its_own_size_is_unchanged() -> None:
    image = np.random.default_rng(3).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    np.testing.assert_array_equal(crop(image, Box(30, 20, 60, 40), 60, 40, (0, 0, 0)), image)


def test_outside_the_image_is_filled() -> None:
    image = np.full((40, 60, 3), 200, np.uint8)
    cut = crop(image, Box(0, 20, 40, 40), 40, 40, (10, 20, 30))
    np.testing.assert_array_equal(cut[:, :19], np.broadcast_to([10, 20, 30], (40, 19, 3)))
    np.testing.assert_array_equal(cut[:, 20:], 200)
