"""Previews of a take: a review video and an interactive page."""
