"""Measures on finished curves, one file a question; `deitalk.evaluate` asks them all."""
