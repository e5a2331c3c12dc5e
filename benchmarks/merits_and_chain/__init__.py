"""Every merit of tolerance studies, held against the whole chain from object to reconstruction."""
