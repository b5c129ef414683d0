"""The networks that are known to run, the folder they are kept in, and their download.

Uses: The standard library alone.
Start at: `table.MODELS`, `store.ModelStore`.
"""

from follower_vision.models.download import DownloadError
from follower_vision.models.store import FileState, ModelStore, default_folder
from follower_vision.models.table import MODELS, ModelFile, Purpose, VisionModel

__all__ = [
    "MODELS",
    "DownloadError",
    "FileState",
    "ModelFile",
    "ModelStore",
    "Purpose",
    "VisionModel",
    "default_folder",
]
