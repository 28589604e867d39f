"""Dataset folders to model folders."""
