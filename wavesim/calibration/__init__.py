"""What a bench does not tell, found from its frames: how the lens is mounted."""
