"""Fine-tuning of curve models on captures of a rig."""
