"""What the page shows, without the page: the lens as it is edited, and figures of it."""
