"""What all three packages share: console, text as it is shown, input files, sections of arrays, clusters."""
