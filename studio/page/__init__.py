"""The page: its frame, its server, and the same in a notebook."""
