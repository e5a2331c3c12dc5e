"""The whole chain as a merit: object, frames through the perturbed lens, reconstruction."""
