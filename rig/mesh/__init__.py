"""Meshes: gradients, reconstruction, files, retargeting (SDFA §3.4-3.5)."""
