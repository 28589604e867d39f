"""Training of mesh models (SDFA and the mesh head): sequences, bases, segments, losses, scores."""
