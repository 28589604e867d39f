"""What a face is: controls, curves, formats, meshes. No torch, no audio, no HTTP."""
