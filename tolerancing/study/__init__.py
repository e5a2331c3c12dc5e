"""A tolerance study: its file, its series of trials, and how one is scored."""
