"""Makes `rig/face/data` from two registry packages; see `make`."""
