"""Wave propagation method: an independent check of the other engines."""
