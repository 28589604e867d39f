"""How controls move the head."""
