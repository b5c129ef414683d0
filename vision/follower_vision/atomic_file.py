"""Writes a file whole or not at all."""

from pathlib import Path


def write_whole(path: Path, text: str) -> Path:
    """Write a file under another name first, so that a reader never sees half of it."""
    return write_whole_bytes(path, text.encode("utf-8"))


def write_whole_bytes(path: Path, content: bytes) -> Path:
    """Do the same with bytes."""
    draft = path.with_name(f".{path.name}.part")
    try:
        draft.write_bytes(content)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path
