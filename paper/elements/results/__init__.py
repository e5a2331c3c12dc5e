"""What the paper shows of objects: Figs. 5 to 8 and 10."""
