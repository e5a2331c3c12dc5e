"""What is carried where: lens, object grid, exit grid; and what every engine can be asked."""
