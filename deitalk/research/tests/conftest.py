"""Fixtures of the product's tests for those of research."""

from tests.conftest import empty_pictures, one_analysis, pytest_runtest_setup, rng, shared

__all__ = ["empty_pictures", "one_analysis", "pytest_runtest_setup", "rng", "shared"]
