"""Speech with known phones: synthesised, or recorded and aligned."""
