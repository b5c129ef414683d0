"""Which packages are installed, and which install the same module.

Nothing of ours is imported here: it is asked when nothing else can be imported, too.
"""

import importlib
import shlex
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import (
    PackageNotFoundError,
    distributions,
    packages_distributions,
    requires,
)

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

_OWN = "drone-target-follower"
SHARED = {"onnxruntime": "onnxruntime", "cv2": "opencv-python-headless"}
"""Modules that several packages install, and the one of them that ours asks for."""
_USED = {"onnxruntime": "InferenceSession", "cv2": "VideoCapture"}
"""What such a module lacks once a package that it shared its files with was uninstalled."""


def shared_modules() -> dict[str, tuple[str, ...]]:
    """Return the packages that install each of the modules that several may; one is right."""
    owners = packages_distributions()
    return {module: tuple(sorted({*owners.get(module, ())})) for module in SHARED}


def unmet_requirements() -> tuple[Requirement, ...] | None:
    """Return what our package asks for and does not find; None if it is not installed itself.

    Another package that installs the same module will do: onnxruntime-gpu for onnxruntime.
    """
    try:
        wanted = [Requirement(text) for text in requires(_OWN) or ()]
    except PackageNotFoundError:
        return None
    versions = {canonicalize_name(one.name): one.version for one in distributions()}
    names = shared_modules()
    in_place_of = {plain: names[module] for module, plain in SHARED.items()}
    unmet = []
    for one in wanted:
        if one.marker is not None and not one.marker.evaluate({"extra": ""}):
            continue
        any_of = (one.name, *in_place_of.get(one.name, ()))
        version = next((v for name in any_of if (v := versions.get(canonicalize_name(name)))), None)
        if version is None or not one.specifier.contains(version, prereleases=True):
            unmet.append(one)
    return tuple(unmet)


def pip(*words: str) -> str:
    """Return a command for this environment's pip."""
    return shlex.join([sys.executable, "-m", "pip", *words])


def installing(requirements: Sequence[Requirement]) -> str:
    """Return the command that installs what is asked for."""
    return pip("install", *(f"{one.name}{one.specifier}" for one in requirements))


def reinstalling(module: str, names: Sequence[str]) -> str:
    """Return the command that leaves one of the packages that install a module, and that whole.

    It is an accelerator's onnxruntime if there is one, and the OpenCV that ours asks for.
    """
    plain = SHARED[module]
    others = [name for name in names if name != plain]
    kept = others[-1] if module == "onnxruntime" and others else plain
    uninstall = f"{pip('uninstall', '-y', *names)} && " if names else ""
    return uninstall + pip("install", kept)


def why_not_importable() -> str:
    """Return which package keeps our own modules from being imported, and the cure; "" if none."""
    for module, names in shared_modules().items():
        try:
            getattr(importlib.import_module(module), _USED[module])
        except (ImportError, AttributeError) as error:
            return f"{error}; type: {reinstalling(module, names)}"
    if unmet := unmet_requirements():
        return f"{', '.join(map(str, unmet))}: not installed; type: {installing(unmet)}"
    return ""


def versions_of(names: Mapping[str, tuple[str, ...]]) -> str:
    """Return the packages with their versions, in words."""
    found = {canonicalize_name(one.name): one.version for one in distributions()}
    wanted = [canonicalize_name(name) for several in names.values() for name in several]
    return ", ".join(f"{name} {found[name]}" for name in wanted if name in found)
