"""Faces of voice agents: curves in step with the sound of a text-to-speech service."""
