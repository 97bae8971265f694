"""Pages for people: reports of runs and rigs, charts, contact sheets."""
