"""What the verdict of a reconstruction says of right and of wrong benches."""
