"""The folder that networks are kept in."""

import json
import logging
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from follower_vision.disk import write_whole
from follower_vision.models.download import DownloadError, Progress, fetch, sha256_of
from follower_vision.models.table import MODELS, ModelFile, VisionModel
from follower_vision.onnx_network import ModelError, path_of
from follower_vision.user_cache import cache_folder

EMBEDDED_FOLDER = Path(__file__).parents[1] / "weights"
"""Where the networks lie that are part of this package."""
_LOGGER = logging.getLogger(__name__)


class FileState(StrEnum):
    """Whether a network's file is there and is the right one."""

    GOOD = "good"
    MISSING = "missing"
    WRONG = "wrong"


def default_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the user's folder: $FOLLOWER_MODELS, or follower/models in the user's cache.

    Raises:
        ModelError: the former is in a home that is not there.
    """
    own = environment.get("FOLLOWER_MODELS")
    if own:
        return path_of(own)
    return cache_folder(environment) / "models"


class ModelStore:
    """Finds, fetches and verifies the networks of a table in one folder.

    Those that are embedded lie in the package itself.
    """

    def __init__(
        self,
        folder: Path,
        models: Sequence[VisionModel] = MODELS,
        embedded: Path = EMBEDDED_FOLDER,
        *,
        reduced: bool = False,
    ) -> None:
        """Manage a folder, which need not exist yet.

        Args:
            folder: where the files lie, under the names in the table.
            models: the table.
            embedded: where those lie that are part of the package.
            reduced: give the files that `prefer` put in place of others.
        """
        self.folder = folder
        self.models = tuple(models)
        self._embedded = embedded
        self._gives_reduced = reduced

    def model(self, name: str) -> VisionModel:
        """Return a network's entry.

        Raises:
            ModelError: there is none of that name.
        """
        for model in self.models:
            if model.name == name:
                return model
        names = ", ".join(model.name for model in self.models)
        raise ModelError(f"there is no network {name!r}; there are {names}")

    def file(self, name: str) -> Path:
        """Return the path of a file, e.g. "nanotrackv3_head.onnx", that is there.

        Raises:
            ModelError: it is not; the message says how to get it.
        """
        path = self._path(name)
        if not path.is_file():
            raise ModelError(f"{path}: no such network; {self.advice(name)}")
        return self._reduced(path) if self._gives_reduced else path

    def prefer(self, original: Path, reduced: Path) -> None:
        """Let a network at reduced precision, in this folder, take an original's place.

        The place is lost when either file changes.

        Raises:
            OSError: the folder cannot be written.
        """
        sums = {"original": sha256_of(original), "sha256": sha256_of(reduced)}
        write_whole(self._note(original), json.dumps({"file": reduced.name, **sums}))

    def withhold(self, original: Path, reduced: Path) -> None:
        """Take an original's place back from a reduced network; another one that has it stays.

        Raises:
            OSError: the folder cannot be written.
        """
        note = self._note(original)
        with suppress(OSError, ValueError, KeyError, TypeError):
            if json.loads(note.read_text("utf-8"))["file"] != reduced.name:
                return
        note.unlink(missing_ok=True)

    def _note(self, original: Path) -> Path:
        return self.folder / f"{original.stem}.preferred.json"

    def _reduced(self, original: Path) -> Path:
        """Return what `prefer` put in a file's place, else the file itself."""
        note = self._note(original)
        if not note.is_file():
            return original
        try:
            said = json.loads(note.read_text("utf-8"))
            path = self.folder / Path(said["file"]).name
            if [sha256_of(original), sha256_of(path)] == [said["original"], said["sha256"]]:
                _LOGGER.info("%s is taken for %s", path.name, original.name)
                return path
        except (OSError, ValueError, KeyError, TypeError) as error:
            _LOGGER.warning("%s is not taken, %s is: %s", note.name, original.name, error)
            return original
        _LOGGER.warning("%s or %s has changed: the latter is taken", path.name, original.name)
        return original

    def paths(self, model: VisionModel) -> list[Path]:
        """Return the paths of all files of a network that is there.

        Raises:
            ModelError: a file is missing; the message says how to get it.
        """
        return [self.file(file.name) for file in model.files]

    def is_present(self, model: VisionModel) -> bool:
        """Return whether all files are there, without reading them."""
        return all(self._path(file.name).is_file() for file in model.files)

    def verify(self, model: VisionModel) -> dict[str, FileState]:
        """Read all files of a network and return, by name, whether they are the right ones."""
        return {file.name: self._state(file) for file in model.files}

    def pull(self, model: VisionModel, progress: Progress | None = None) -> list[Path]:
        """Fetch those files of a network that are not there or not right.

        Of an embedded network nothing is fetched.

        Args:
            model: what to fetch.
            progress: called now and then with the bytes of the whole network that are there, and
                those wanted.

        Returns:
            The files' paths.

        Raises:
            DownloadError: a file cannot be fetched; the message is one line and says what to do.
        """
        if model.embedded:
            return self.paths(model)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DownloadError(f"cannot make {self.folder}: {error.strerror}") from error
        before = 0
        for file in model.files:
            report = _shifted(progress, before, model.size_bytes)
            if self._state(file) is not FileState.GOOD:
                fetch(file, self.folder / file.name, report)
            report(file.size_bytes, file.size_bytes)
            before += file.size_bytes
        return self.paths(model)

    def advice(self, file_name: str) -> str:
        """Return how to get a file."""
        for model in self.models:
            if file_name in [file.name for file in model.files]:
                if model.embedded:
                    return f"{model.name} is part of this package: install it again"
                if model.can_be_fetched:
                    return f"`follower models pull {model.name}` fetches it"
                return f"{model.name} cannot be fetched: put your own copy there"
        return "it is none of ours: put your own copy there"

    def _path(self, name: str) -> Path:
        ours = [file.name for model in self.models if model.embedded for file in model.files]
        return (self._embedded if name in ours else self.folder) / name

    def _state(self, file: ModelFile) -> FileState:
        path = self._path(file.name)
        if not path.is_file():
            return FileState.MISSING
        right = path.stat().st_size == file.size_bytes and sha256_of(path) == file.sha256
        return FileState.GOOD if right else FileState.WRONG


def _shifted(progress: Progress | None, before: int, wanted: int) -> Progress:
    """Turn one file's progress into that of all files."""

    def report(done: int, _: int) -> None:
        if progress is not None:
            progress(before + done, wanted)

    return report
