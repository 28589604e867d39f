"""Blind comparisons of takes by people: the page that shows them, and the report of the answers."""
