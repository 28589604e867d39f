"""Where the listener is."""

NO_PLACE = (0.0, 0.0, 65.0)
"""Where a listener is if no place is given: ahead; degrees and cm."""
