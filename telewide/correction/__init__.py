"""What makes the two views comparable: rows, colour, and a verdict on the pair."""
