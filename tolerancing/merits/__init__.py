"""What a perturbed lens is scored by: rays, reconstruction pupil, waves, bars, or Python."""
