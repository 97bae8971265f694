"""Two comparable views to a disparity map: networks and the semi-global baseline."""
