"""Lips of people, measured; the head's lips; and curves that make the second do as the first."""
