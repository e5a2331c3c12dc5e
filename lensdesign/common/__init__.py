"""What all three packages share: console, text as it is shown, input files, notebooks, clusters."""
