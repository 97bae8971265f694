"""Two lenses to a rig: from photos of a board, or from ordinary captures."""
