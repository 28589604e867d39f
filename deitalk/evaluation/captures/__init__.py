"""Scores on captured curves, and a tuned model before and after."""
