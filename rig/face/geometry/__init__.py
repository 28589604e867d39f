"""The neutral head: skin, eyes, ears, hair and teeth."""
