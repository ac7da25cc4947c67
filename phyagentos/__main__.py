"""`python -m phyagentos` is `paos`."""

from phyagentos.cli.app import main

if __name__ == "__main__":
    main()
