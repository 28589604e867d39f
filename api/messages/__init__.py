"""Requests into orders, answers out of results, and their documentation."""
