"""The stages of a run, each with its options, its record in the run folder and what it refuses."""
