"""What people look at: fields, frames, reconstructions, comparisons, pages that zoom."""
