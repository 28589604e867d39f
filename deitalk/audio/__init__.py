"""Recordings to mono 16 kHz, and what is measured on them."""
