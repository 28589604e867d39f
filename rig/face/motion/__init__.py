"""Motion of the head by its controls."""
