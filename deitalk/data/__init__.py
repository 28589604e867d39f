"""Dataset folders: what a user brings and what the corpus builder writes."""
