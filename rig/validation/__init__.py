"""Checks of files by the rules of the programs that import them."""
