"""`python -m phyagentos` is `paos`."""

import sys


def main() -> None:
    """Entry point of the console script `paos`: a Ctrl-C ends it quietly, also while it imports."""
    try:
        from phyagentos.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
