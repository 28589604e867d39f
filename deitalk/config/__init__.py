"""Settings of models, losses, data and training; defaults are the papers' numbers.

A YAML file in ``configs/`` holds only what differs. Modules take plain numbers; only the builders
of networks and trainings read these classes, and the rules after the network theirs.
"""
