"""What calculations run on: threads, memory, scratch files, array libraries, GPUs, checkpoints."""
