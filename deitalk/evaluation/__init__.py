"""Measures on finished curves, one file a question; `deitalk.evaluation.curves` asks them all."""
