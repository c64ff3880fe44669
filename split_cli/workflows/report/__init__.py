"""The HTML pages of ingest, evaluate, compare and diagnose: each is one file that loads nothing else.

May import: what workflows may. `words` speaks, `payload` packs numbers, `sections` writes, `page` puts together.
"""
