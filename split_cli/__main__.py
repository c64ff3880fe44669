"""`python -m split_cli` is the command `split`."""

import signal

__all__ = ["main"]


def main() -> None:
    """Run the command line of this process; Ctrl-C while it still loads ends it without a traceback."""
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from split_cli.cli import main as run

    signal.signal(signal.SIGINT, usual)
    run()  # which sets a handler of its own first


if __name__ == "__main__":
    main()
