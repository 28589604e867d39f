"""Datasets of measured lips for experiments."""
