"""Writes a file whole or not at all."""

from pathlib import Path


def write_whole(path: Path, text: str) -> Path:
    """Write a file under another name first, so that a reader never sees half of it.

    Raises:
        OSError: it cannot be written; `filename` is the file's, and nothing of it is left.
    """
    return write_whole_bytes(path, text.encode("utf-8"))


def write_whole_bytes(path: Path, content: bytes) -> Path:
    """Do the same with bytes."""
    draft = path.with_name(f".{path.name}.part")
    try:
        draft.write_bytes(content)
        draft.replace(path)
    except OSError as error:
        error.filename, error.filename2 = str(path), None
        raise
    finally:
        draft.unlink(missing_ok=True)
    return path
