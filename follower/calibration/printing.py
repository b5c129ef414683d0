"""Writes a board to be printed: to scale, as PDF or as PNG that knows its resolution."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import cv2

from follower.calibration.board import Board, Cells
from follower.report.writer import write_whole_bytes

_POINT_M = 0.0254 / 72
_PAPERS_M = {"A4": (0.210, 0.297), "A3": (0.297, 0.420), "A2": (0.420, 0.594)}
_MARGIN_M = 0.005
_DOTS_A_METRE = 12_000


def write_board(board: Board, path: Path) -> str:
    """Write the board into a .pdf or .png; return in words how large it is.

    Raises:
        ValueError: the file is to be something else.
        OSError: it cannot be written.
    """
    across_mm, down_mm = (1e3 * side for side in _sides_m(board))
    size = f"{across_mm:g} x {down_mm:g} mm, squares of {1e3 * board.square_m:g} mm"
    if path.suffix.lower() == ".pdf":
        paper, page_m = _paper_for(board)
        write_whole_bytes(path, _pdf(board, page_m))
        return f"{size}, on {paper}"
    if path.suffix.lower() == ".png":
        write_whole_bytes(path, _png(board))
        return size
    raise ValueError(f"--board {path}: give a name that ends in .pdf or .png")


def _sides_m(board: Board) -> tuple[float, float]:
    return board.across * board.square_m, board.down * board.square_m


def _paper_for(board: Board) -> tuple[str, tuple[float, float]]:
    """Return the smallest paper on which it fits, upright; else a page of its own."""
    across, down = _sides_m(board)
    for name, page in _PAPERS_M.items():
        if across + 2 * _MARGIN_M <= page[0] and down + 2 * _MARGIN_M <= page[1]:
            return name, page
    return "a page of its own", (across + 4 * _MARGIN_M, down + 4 * _MARGIN_M)


def _pdf(board: Board, page_m: tuple[float, float]) -> bytes:
    """Return one page with a filled rectangle for each black run of cells."""
    width, height = (side / _POINT_M for side in page_m)
    across, down = (side / _POINT_M for side in _sides_m(board))
    cell = board.square_m / board.cells_a_square / _POINT_M
    left, top = (width - across) / 2, (height + down) / 2
    drawn = "\n".join(
        f"{left + x * cell:.4f} {top - (y + 1) * cell:.4f} {count * cell:.4f} {cell:.4f} re f"
        for x, y, count in _black_runs(board.cells())
    )
    return _pdf_of(width, height, drawn.encode("ascii"))


def _black_runs(cells: Cells) -> Iterator[tuple[int, int, int]]:
    """Yield (first column, row, how many) of black cells beside each other."""
    for y, row in enumerate(cells):
        x = 0
        for black, run in groupby(bool(value < 128) for value in row):
            count = len(list(run))
            if black:
                yield x, y, count
            x += count


def _pdf_of(width: float, height: float, drawn: bytes) -> bytes:
    objects = (
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents 4 0 R "
        "/Resources << >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(drawn), drawn),
    )
    pdf, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(pdf))
        pdf += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    entries = b"".join(b"%010d 00000 n \n" % place for place in places)
    count = len(objects) + 1
    table = b"xref\n0 %d\n0000000000 65535 f \n%s" % (count, entries)
    return (
        pdf
        + table
        + b"trailer << /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n"
        % (
            count,
            len(pdf),
        )
    )


def _png(board: Board) -> bytes:
    """Return an image with a white rim, and how many of its dots make a metre."""
    cell_m = board.square_m / board.cells_a_square
    scale = max(1, round(cell_m * _DOTS_A_METRE))
    image = board.cells().repeat(scale, 0).repeat(scale, 1)
    rim = round(2 * _MARGIN_M / cell_m * scale)
    framed = cv2.copyMakeBorder(image, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=255.0)
    _, encoded = cv2.imencode(".png", framed)
    dots = round(scale / cell_m)
    body = b"pHYs" + struct.pack(">IIB", dots, dots, 1)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    png = encoded.tobytes()
    after_header = 8 + 4 + 4 + 13 + 4
    return png[:after_header] + chunk + png[after_header:]
