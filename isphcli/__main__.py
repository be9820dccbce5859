"""`python -m isphcli` is `isph`."""

from .cli import main

if __name__ == "__main__":
    main()
