"""Page of the workbench: frame, server, and the view in a notebook."""
