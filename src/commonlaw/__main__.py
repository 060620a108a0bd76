"""`python -m commonlaw`: the command line."""

from commonlaw.cli import main

if __name__ == "__main__":
    main()
