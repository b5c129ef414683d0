"""What the benchmarks' command lines share: their docstrings as help, and plain refusals."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path

from follower.links.connections import ConnectionFailedError
from follower_control.common.strict_config import SettingsError
from follower_vision.evaluation.one_pass import DatasetError
from follower_vision.onnx_network import ModelError
from follower_vision.sources.frame_source import SourceError

USER_ERRORS = ConnectionFailedError, DatasetError, ModelError, OSError, SettingsError, SourceError


def parser(about: str) -> argparse.ArgumentParser:
    """Return a parser whose help shows a program's docstring as it stands."""
    form = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(description=about, formatter_class=form)


def positive(text: str) -> float:
    """Read a number.

    Raises:
        ValueError: it is not above zero and finite.
    """
    value = float(text)
    if not 0.0 < value < math.inf:
        raise ValueError
    return value


def count(text: str) -> int:
    """Read how many.

    Raises:
        ValueError: fewer than one.
    """
    value = int(text)
    if value < 1:
        raise ValueError
    return value


def run(main: Callable[[], object]) -> None:
    """Run a program; what its user can mend ends in one line and exit code 2."""
    try:
        main()
    except USER_ERRORS as error:
        print(f"{Path(sys.argv[0]).stem}: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
