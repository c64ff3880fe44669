"""Studies that take too long for a test: commands whose tables are kept in docs/records, some in docs/decisions."""
