"""Known worlds and known damage: scenes with exact truth, degradation of photos."""
