"""Work on what a request sends, in processes of its own with limits of memory and time."""
