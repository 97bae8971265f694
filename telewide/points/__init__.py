"""Points found in both photos of a pair: sparse, matched two ways, robustly fitted."""
