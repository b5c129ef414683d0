"""The table of networks, which stands in models.toml."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources


class Purpose(StrEnum):
    """What a network is for."""

    DETECTOR = "detector"
    TRACKER = "tracker"


@dataclass(frozen=True, slots=True)
class ModelFile:
    """One file of a network.

    Attributes:
        name: in the models' folder.
        size_bytes: its length.
        sha256: in hexadecimal digits.
        addresses: where it may be fetched, the first choice first; none if it may not.
    """

    name: str
    size_bytes: int
    sha256: str
    addresses: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class VisionModel:
    """A network: one file, or several that belong together.

    Attributes:
        name: by which the user and the configuration call it.
        purpose: what it is for.
        summary: one line for the user.
        licence: SPDX name, or plain words where it is not so simple.
        origin: who made it.
        files: all that it consists of.
        family: of a detector, how its answer is read; a key of the detectors' families.
        classes: what a detector knows, in words.
        usual: fetched where the user names none.
        embedded: our own, and part of this package: there is nothing to fetch.
    """

    name: str
    purpose: Purpose
    summary: str
    licence: str
    origin: str
    files: tuple[ModelFile, ...]
    family: str = ""
    classes: str = ""
    usual: bool = False
    embedded: bool = False

    @property
    def size_bytes(self) -> int:
        """The length of all files together."""
        return sum(file.size_bytes for file in self.files)

    @property
    def can_be_fetched(self) -> bool:
        """Whether every file has an address."""
        return not self.embedded and all(file.addresses for file in self.files)


def _read_table() -> Iterator[VisionModel]:
    """Yield the entries of models.toml; a wrong key or purpose is an error."""
    text = (resources.files(__package__) / "models.toml").read_text("utf-8")
    for entry in tomllib.loads(text)["model"]:
        files = [
            ModelFile(**{**file, "addresses": tuple(file.get("addresses", ()))})
            for file in entry["files"]
        ]
        yield VisionModel(**{**entry, "purpose": Purpose(entry["purpose"]), "files": tuple(files)})


MODELS: tuple[VisionModel, ...] = tuple(_read_table())
