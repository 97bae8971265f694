"""Public stereo sets, read as pairs with truth: a file for each layout."""
