"""Files that hold lenses: design files of our own, measured figures, Zemax and CODE V."""
