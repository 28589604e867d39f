"""Ablations, trainers of small networks, and tools that change the weights of a model."""
