"""Curves from one control set to another: the board, raw curves, ARKit, visemes."""
