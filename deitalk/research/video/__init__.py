"""Videos of a speaking person to rig curves: landmarks, measures, curves that repeat them."""
