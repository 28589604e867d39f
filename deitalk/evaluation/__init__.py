"""Scores of finished curves and meshes, one file per measure; `curves` and `mesh` collect them."""
