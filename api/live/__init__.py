"""Frames while somebody speaks: the offline model, run again and again on the last seconds."""
