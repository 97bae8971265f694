"""Writers of depth for other programs, one format a file; the table of them is in `telewide.depth.export`."""
