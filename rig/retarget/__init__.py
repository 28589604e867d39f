"""Curves or vertex sequences on another mesh."""
