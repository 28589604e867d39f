"""Words that are known: their phones' times in a recording, and how well the sound fits them."""
