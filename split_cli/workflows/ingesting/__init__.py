"""From recordings to drives, and the first files of a newcomer: `split ingest`, `split init`.

May import: the modules directly in `workflows/`, and every package but cli.
"""
