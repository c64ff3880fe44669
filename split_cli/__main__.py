"""`python -m split_cli` is the command `split`."""

from split_cli.cli import main

if __name__ == "__main__":
    main()
