"""`python -m split_cli` is the command `split`."""

import signal

__all__ = ["main"]


def main() -> None:
    """Run the command line of this process; Ctrl-C while it still loads ends it without a traceback."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from split_cli.cli import main as run

    run()  # which sets a handler of its own first


if __name__ == "__main__":
    main()
