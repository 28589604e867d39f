"""Figures drawn with matplotlib from arrays."""
