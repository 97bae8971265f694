"""What comes in: photos, capture folders, data sets, the run folder."""
