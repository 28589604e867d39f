"""Scores against people: measured lips, acted strength."""
