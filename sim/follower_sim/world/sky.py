"""The sky with clouds and distant hills: a panorama drawn around the horizon."""

import cv2
import numpy as np

from follower_sim.bodies.mesh import Colour
from follower_sim.view import CameraView
from follower_sim.world.ground import PixelRays
from follower_sim.world.ground_pyramid import Plane
from follower_sim.world.noise import layered_noise
from follower_vision.geometry.camera_model import Vector
from follower_vision.images.frame import Image

_PX_PER_DEG = 4.0
_LOWEST_DEG, _HIGHEST_DEG = -4.0, 90.0
_MARGIN_DEG = 120.0
_BLOCK = 16
# From every second pixel's middle, as OpenCV's `resize` puts it between two pixels, to the nodes.
_BETWEEN_NODES = np.array([[2 / _BLOCK, 0, 0.5 / _BLOCK], [0, 2 / _BLOCK, 0.5 / _BLOCK]])
_BLUE = np.array([206.0, 158.0, 104.0])
_CLOUD = np.array([244.0, 242.0, 240.0])
_HILL = np.array([128.0, 134.0, 104.0])


def panorama(haze: Colour, clouds: float, hills: bool, rng: np.random.Generator) -> Image:
    """Generate the sky all around, rows from the highest elevation down, columns eastward.

    Args:
        haze: colour at the horizon.
        clouds: share of the sky that they cover.
        hills: whether hills rise behind the horizon.
        rng: source of randomness.
    """
    columns, rows = round(360 * _PX_PER_DEG), round((_HIGHEST_DEG - _LOWEST_DEG) * _PX_PER_DEG)
    elevation = elevations_deg(rows)[:, None]
    depth = 1 - np.exp(-np.maximum(elevation, 0) / 16)
    base = np.array(haze, np.float64) * (1 - depth[..., None]) + _BLUE * depth[..., None]
    sky = np.broadcast_to(base, (rows, columns, 3)).copy()
    cover = _clouds(rows, columns, clouds, rng) * np.clip(elevation / 5, 0, 1)
    sky += (_CLOUD - sky) * (cover * 0.85)[..., None]
    if hills:
        _raise_hills(sky, elevation, np.array(haze, np.float64), rng)
    image = np.clip(sky, 0, 255).astype(np.uint8)
    margin = round(_MARGIN_DEG * _PX_PER_DEG)
    return np.hstack([image[:, -margin:], image, image[:, :margin]])


def elevations_deg(rows: int) -> Vector:
    """Return the elevation of each row of a panorama, from the highest down."""
    return np.linspace(_HIGHEST_DEG, _LOWEST_DEG, rows)


def _clouds(rows: int, columns: int, share: float, rng: np.random.Generator) -> Vector:
    """Return how much cloud there is, 0 to 1; flattened, and joined at the ends."""
    if share <= 0:
        return np.zeros((rows, columns))
    layers = [(60.0, 26.0), (22.0, 18.0), (8.0, 9.0), (3.0, 4.0)]
    tall = layered_noise(rng, rows * 2, columns + 240, layers)
    noise = cv2.resize(tall, (columns + 240, rows), interpolation=cv2.INTER_AREA).astype(np.float64)
    fade = np.linspace(0, 1, 240)
    joined = noise[:, :columns].copy()
    joined[:, :240] = joined[:, :240] * fade + noise[:, columns:] * (1 - fade)
    limit = float(np.quantile(joined, 1 - share))
    return np.clip((joined - limit) / 28, 0, 1)


def _raise_hills(sky: Vector, elevation: Vector, haze: Vector, rng: np.random.Generator) -> None:
    """Draw two rows of hills in the mist, the farther one paler."""
    azimuth = np.linspace(0, 2 * np.pi, sky.shape[1], endpoint=False)
    for tallest, paleness in ((4.2, 0.55), (2.1, 0.2)):
        waves = sum(
            np.cos(k * azimuth + rng.uniform(0, 2 * np.pi)) / k**0.7 for k in (2, 3, 5, 9, 14, 23)
        )
        top = tallest * np.clip(0.45 + 0.22 * np.asarray(waves), 0.05, 1)
        cover = np.clip((top - elevation) * _PX_PER_DEG + 0.5, 0, 1)[..., None]
        mist = np.clip(1 - elevation / tallest, paleness, 1)[..., None]
        sky += (haze * mist + _HILL * (1 - mist) - sky) * cover


class SkyPainter:
    """Paints the part of a panorama that a camera sees.

    Directions are computed at the corners of blocks of 16 pixels and interpolated between them, and
    colours at every second pixel: the sky has no structure fine enough to show either.
    """

    def __init__(self, sky: Image, rays: PixelRays) -> None:
        self._sky = sky
        nodes = [_block_corners(plane) for plane in (rays.x, rays.y)]
        self._nodes = np.stack([*nodes, np.ones_like(nodes[0])], -1)

    def paint(self, image: Image, view: CameraView) -> None:
        """Paint all rows that reach above the horizon; the ground is painted over them later."""
        directions = self._nodes @ view.world_to_camera
        rising = directions[..., 2] < 0.002
        blocks = np.flatnonzero(rising.any(axis=1))
        if not len(blocks):
            return
        first = max(0, int(blocks[0]) - 1)
        part = image[first * _BLOCK : (int(blocks[-1]) + 1) * _BLOCK]
        nodes = directions[first : int(blocks[-1]) + 2]
        size = (part.shape[1] + 1) // 2, (part.shape[0] + 1) // 2
        if (nodes @ (*view.world_to_camera[2, :2], 0.0) <= 0).any():
            # About the zenith azimuths run all around: nothing can be interpolated between them.
            x, y = self._sky_pixels(_between_nodes(nodes, size), view)
            places = np.dstack([x % (360 * _PX_PER_DEG), y])
        else:
            places = _between_nodes(np.dstack(self._sky_pixels(nodes, view)), size)
        x, y = np.moveaxis(places.astype(np.float32), -1, 0)
        mode = cv2.BORDER_REPLICATE
        seen = cv2.remap(self._sky, x, y, cv2.INTER_LINEAR, None, mode)
        whole = cv2.resize(seen, (seen.shape[1] * 2, seen.shape[0] * 2))
        part[:] = whole[: part.shape[0], : part.shape[1]]

    def _sky_pixels(self, directions: Vector, view: CameraView) -> tuple[Vector, Vector]:
        heading = np.arctan2(view.world_to_camera[2, 1], view.world_to_camera[2, 0])
        north, east, down = np.moveaxis(directions, -1, 0)
        right = east * np.cos(heading) - north * np.sin(heading)
        ahead = north * np.cos(heading) + east * np.sin(heading)
        azimuth = np.degrees(np.arctan2(right, ahead)) + np.degrees(heading) % 360
        elevation = np.degrees(np.arctan2(-down, np.hypot(north, east)))
        x = (azimuth + _MARGIN_DEG) * _PX_PER_DEG - 0.5
        y = (_HIGHEST_DEG - elevation) * _PX_PER_DEG - 0.5
        return x, y


def _between_nodes(nodes: Vector, size: tuple[int, int]) -> Vector:
    """Return what lies between the nodes at every second pixel's middle, (H, W, channels)."""
    flags, mode = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
    found = cv2.warpAffine(
        nodes.astype(np.float32), _BETWEEN_NODES, size, flags=flags, borderMode=mode
    )
    return np.asarray(found, np.float64)


def _block_corners(plane: Plane) -> Plane:
    """Return the values at every 16th pixel, and beyond the last ones by extrapolation."""
    rows, columns = (np.arange(0, n + _BLOCK, _BLOCK) for n in plane.shape)
    beyond = cv2.copyMakeBorder(plane, 0, _BLOCK, 0, _BLOCK, cv2.BORDER_REPLICATE)
    height, width = plane.shape
    ahead = np.arange(1, _BLOCK + 1, dtype=np.float32)
    beyond[height:] += ahead[:, None] * (beyond[height - 1] - beyond[height - 2])
    beyond[:, width:] += ahead * (beyond[:, width - 1 : width] - beyond[:, width - 2 : width - 1])
    rows, columns = rows[rows < len(beyond)], columns[columns < beyond.shape[1]]
    return np.asarray(beyond[np.ix_(rows, columns)], np.float32)
