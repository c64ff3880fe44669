"""The HTML pages of ingest, evaluate, compare and diagnose: each is one file that loads nothing else.

May import: what workflows may. `words` makes sentences, `payload` the numbers, `sections` the parts of a
page, and `page` the whole.
"""
