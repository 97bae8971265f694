"""Input: photos, capture folders, data sets, the run folder."""
