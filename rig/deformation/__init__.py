"""Deformation gradients per triangle and the way back to vertices (SDFA §3.4-3.5)."""
