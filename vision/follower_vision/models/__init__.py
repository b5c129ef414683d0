"""The networks that are known to run, and the folder that they are kept in."""

from follower_vision.models.download import DownloadError
from follower_vision.models.model import Model, ModelFile, Purpose
from follower_vision.models.store import FileState, ModelStore, default_folder
from follower_vision.models.table import MODELS

__all__ = [
    "MODELS",
    "DownloadError",
    "FileState",
    "Model",
    "ModelFile",
    "ModelStore",
    "Purpose",
    "default_folder",
]
