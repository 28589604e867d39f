"""Frames while somebody speaks, over WebSocket and gRPC."""
