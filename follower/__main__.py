"""The program's start: where its packages are damaged it says how to mend them."""

import sys
from importlib.metadata import version
from typing import NoReturn

_UNUSABLE, _INTERRUPTED = 2, 130


def main() -> NoReturn:
    """Run the command line; exit code 2 and one line if it cannot be imported."""
    if sys.argv[1:] == [
        "--version"
    ]:  # says it before the packages are loaded, which takes a second
        print(f"follower {version('drone-target-follower')}")  # noqa: T201
        sys.exit()
    try:
        from follower.apps.main import main as run
    except (ImportError, AttributeError):
        from follower.apps.doctor.packages import why_not_importable

        if not (why := why_not_importable()):
            raise
        print(f"follower: {why}", file=sys.stderr)  # noqa: T201  nothing else can be imported
        sys.exit(_UNUSABLE)
    except KeyboardInterrupt:  # within the second that the packages take to load
        sys.exit(_INTERRUPTED)
    run()


if __name__ == "__main__":
    main()
