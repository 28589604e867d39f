"""The networks of both papers, one file per stage, and their model folders."""
