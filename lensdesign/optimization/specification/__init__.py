"""What a search is asked for: the specification and its parts."""
