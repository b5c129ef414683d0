"""The program's start: where its packages are damaged it says how to mend them."""

import sys
from typing import NoReturn

_UNUSABLE = 2


def main() -> NoReturn:
    """Run the command line; exit code 2 and one line if it cannot be imported."""
    try:
        from follower.apps.main import main as run
    except (ImportError, AttributeError):
        from follower.apps.doctor.packages import why_not_importable

        if not (why := why_not_importable()):
            raise
        print(f"follower: {why}", file=sys.stderr)  # noqa: T201  nothing else can be imported
        sys.exit(_UNUSABLE)
    run()


if __name__ == "__main__":
    main()
