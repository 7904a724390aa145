"""Files: written whole or not at all, and records in archives that are data only."""
