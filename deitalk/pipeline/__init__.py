"""From a recording to curves or a mesh."""
