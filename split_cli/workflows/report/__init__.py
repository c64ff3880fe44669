"""The report of a diagnosis: one HTML page that needs nothing beside itself.

May import: what workflows may. `words` speaks, `payload` packs numbers, `sections` writes, `page` puts together.
"""
