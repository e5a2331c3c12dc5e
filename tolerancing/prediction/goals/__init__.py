"""Goals of a search for lenses as built: values of drawn lenses with exact derivatives."""
