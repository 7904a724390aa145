"""Outside engines."""
