"""The script that a user runs inside Unreal; nothing here is imported by the rest."""
