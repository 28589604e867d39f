"""A recording to curves or a mesh, and the take folder."""
