"""From photos of a board to a rig."""
