"""What can be wrong with a lens as made and mounted, and how likely."""
