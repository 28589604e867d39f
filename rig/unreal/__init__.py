"""The script that runs inside Unreal; no other module imports it."""
