"""The program `optimise`."""

import sys

from ._native import main as _main


def main() -> None:
    """Runs it with the process's arguments."""
    sys.exit(_main(["optimise", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
