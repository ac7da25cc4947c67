"""`python -m phyagentos` is `paos`."""

import gc
import sys


def main() -> None:
    """Entry point of the console script `paos`: a Ctrl-C ends it quietly, also while it imports."""
    gc.disable()  # nothing that is being loaded is garbage
    try:
        from phyagentos.cli.app import main as run

        gc.enable()
        run()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
