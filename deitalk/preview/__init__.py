"""Ways to watch a take: a review video and an interactive page."""
