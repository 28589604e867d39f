"""Speech in, an acted MetaHuman face out."""

__version__ = "0.1.0"
