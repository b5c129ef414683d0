"""The printed board: what it looks like, and where its corners are in an image."""

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt
import PIL.Image

from follower_vision.disk import write_whole_bytes
from follower_vision.images.frame import Image

Kind: TypeAlias = Literal["charuco", "chessboard"]
Cells: TypeAlias = npt.NDArray[np.uint8]
Points: TypeAlias = npt.NDArray[np.float32]

_MARKER_CELLS = 7
_SQUARE_CELLS = 9
"""A marker of 5 x 5 bits has a black border of one cell; around it one white cell is left."""
_DRAWN_PX = 10
_DICTIONARY = cv2.aruco.DICT_5X5_100
_LEAST_CORNERS = 8
_FREE_OF_MARKERS, _FREE_OF_CORNERS = 1 / 8, 0.3
_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.01)
_LEAST_SQUARES, _MOST_MARKERS = 3, 100
_INCH_M = 0.0254
_PAPERS_M = {"A4": (0.210, 0.297), "A3": (0.297, 0.420), "A2": (0.420, 0.594)}
_MARGIN_M = 0.005
_DOTS_A_METRE, _MOST_DOTS = 12_000, 20_000


@dataclass(frozen=True, slots=True)
class SeenBoard:
    """The corners of a board in one image.

    Attributes:
        board_m: (N, 3) on the board, in metres; z is 0.
        image_px: (N, 2) in the image, from the corner of its top-left pixel.
        ids: (N,) which of the board's inner corners they are, row by row.
    """

    board_m: Points
    image_px: Points
    ids: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Board:
    """A flat board of black and white squares.

    Attributes:
        kind: "charuco" has a marker in each white square, so that a part of it is enough and it
            may be turned any way; "chessboard" has to be seen whole.
        across, down: squares in a row and in a column.
        square_m: side of a square.

    Raises:
        ValueError: there is no such board.
    """

    kind: Kind = "charuco"
    across: int = 7
    down: int = 10
    square_m: float = 0.025

    def __post_init__(self) -> None:
        if min(self.across, self.down) < _LEAST_SQUARES:
            raise ValueError(f"a board has {_LEAST_SQUARES} x {_LEAST_SQUARES} squares at least")
        if not 0.001 <= self.square_m <= 1:
            raise ValueError("a square's side lies between 1 and 1000 mm")
        if self.kind == "charuco" and self.across * self.down // 2 > _MOST_MARKERS:
            raise ValueError(f"there are {_MOST_MARKERS} markers: take fewer squares")
        if self.kind == "chessboard" and (self.across + self.down) % 2 == 0:
            raise ValueError(
                "a chessboard has an even number of squares one way and an odd one the other: "
                "else nobody can tell which way up it is"
            )

    @property
    def corners(self) -> int:
        """How many inner corners it has."""
        return (self.across - 1) * (self.down - 1)

    @cached_property
    def grid_m(self) -> Points:
        """All inner corners, row by row, in metres from the board's top left corner."""
        x, y = np.meshgrid(np.arange(1, self.across), np.arange(1, self.down))
        flat = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
        return np.asarray(flat * self.square_m, np.float32)

    def cells(self) -> Cells:
        """Return how it is printed: 0 is black, 255 white, `cells_a_square` to a square's side."""
        if self.kind == "chessboard":
            x, y = np.meshgrid(np.arange(self.across), np.arange(self.down))
            return np.where((x + y) % 2 == 0, 0, 255).astype(np.uint8)
        size = self.across * _SQUARE_CELLS * _DRAWN_PX, self.down * _SQUARE_CELLS * _DRAWN_PX
        drawn = self._charuco.generateImage(size, marginSize=0, borderBits=1)
        return np.asarray(drawn[_DRAWN_PX // 2 :: _DRAWN_PX, _DRAWN_PX // 2 :: _DRAWN_PX])

    @property
    def cells_a_square(self) -> int:
        """See `cells`."""
        return _SQUARE_CELLS if self.kind == "charuco" else 1

    def find(self, image: Image) -> SeenBoard | None:
        """Return its corners in an image, to a fraction of a pixel; None if it is not seen."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        found = self._find_charuco(grey) if self.kind == "charuco" else self._find_squares(grey)
        if found is None:
            return None
        ids, corners = found
        # OpenCV counts from the middle of the first pixel.
        placed = self._refined(grey, corners) + np.float32(0.5)
        return SeenBoard(self.grid_m[ids], placed, ids)

    def _refined(self, grey: Cells, corners: Points) -> Points:
        """Return the corners by the edges that meet in them, as far as no marker is near.

        Without it a distorted chessboard's corners are off by 0.1 px, and the focal length by 1 %.
        """
        side_px = float(np.median(np.hypot(*np.diff(corners, axis=0).T)))
        share = _FREE_OF_MARKERS if self.kind == "charuco" else _FREE_OF_CORNERS
        reach = int(np.clip(round(share * side_px), 2, 9))
        refined = cv2.cornerSubPix(grey, corners.copy(), (reach, reach), (-1, -1), _UNTIL)
        return np.asarray(refined, np.float32).reshape(-1, 2)

    def _find_squares(self, grey: Cells) -> tuple[npt.NDArray[np.int64], Points] | None:
        size = (self.across - 1, self.down - 1)
        found, corners = cv2.findChessboardCornersSB(grey, size, None, cv2.CALIB_CB_ACCURACY)
        if not found:
            return None
        return np.arange(self.corners), np.asarray(corners, np.float32).reshape(-1, 2)

    def _find_charuco(self, grey: Cells) -> tuple[npt.NDArray[np.int64], Points] | None:
        corners, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None or len(ids) < _LEAST_CORNERS:
            return None
        flat = np.asarray(ids, np.int64).reshape(-1)
        rows = np.unique(flat // (self.across - 1))
        columns = np.unique(flat % (self.across - 1))
        if min(len(rows), len(columns)) < 2:
            return None
        return flat, np.asarray(corners, np.float32).reshape(-1, 2)

    @cached_property
    def _charuco(self) -> cv2.aruco.CharucoBoard:
        dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
        marker_m = self.square_m * _MARKER_CELLS / _SQUARE_CELLS
        return cv2.aruco.CharucoBoard((self.across, self.down), self.square_m, marker_m, dictionary)

    @cached_property
    def _detector(self) -> cv2.aruco.CharucoDetector:
        refined = cv2.aruco.DetectorParameters()
        refined.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        return cv2.aruco.CharucoDetector(self._charuco, cv2.aruco.CharucoParameters(), refined)


def write_board(board: Board, path: Path) -> str:
    """Write the board into a .pdf or .png, to scale; return in words how large it is.

    Raises:
        ValueError: the file is to be something else.
        OSError: it cannot be written.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("pdf", "png"):
        raise ValueError(f"--board {path}: give a name that ends in .pdf or .png")
    across_m, down_m = board.across * board.square_m, board.down * board.square_m
    paper, (width_m, height_m) = _paper_for(across_m, down_m)
    cell_m = board.square_m / board.cells_a_square
    dots_a_metre = min(_DOTS_A_METRE, _MOST_DOTS / max(width_m, height_m))
    cell = max(1, round(cell_m * dots_a_metre))
    image = board.cells().repeat(cell, 0).repeat(cell, 1)
    height, width = image.shape
    page = np.full((round(height_m * cell / cell_m), round(width_m * cell / cell_m)), 255, np.uint8)
    top, left = (page.shape[0] - height) // 2, (page.shape[1] - width) // 2
    page[top : top + height, left : left + width] = image
    dpi = cell / cell_m * _INCH_M
    encoded = io.BytesIO()
    PIL.Image.fromarray(page).convert("1").save(encoded, kind, dpi=(dpi, dpi), resolution=dpi)
    write_whole_bytes(path, encoded.getvalue())
    size = f"{1e3 * across_m:g} x {1e3 * down_m:g} mm, squares of {1e3 * board.square_m:g} mm"
    return f"{size}, on {paper}"


def _paper_for(across_m: float, down_m: float) -> tuple[str, tuple[float, float]]:
    """Return the smallest paper on which the board fits, upright; else a page of its own."""
    for name, page in _PAPERS_M.items():
        if across_m + 2 * _MARGIN_M <= page[0] and down_m + 2 * _MARGIN_M <= page[1]:
            return name, page
    return "a page of its own", (across_m + 4 * _MARGIN_M, down_m + 4 * _MARGIN_M)
