"""Known worlds and known damage."""
