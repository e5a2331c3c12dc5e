"""Wave propagation method, a check."""
