"""Checks of files of curves by the rules of the programs that import them."""
