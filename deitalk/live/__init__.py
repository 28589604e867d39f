"""Curves of a voice that has not ended: frames a fifth of a second after their sound."""
