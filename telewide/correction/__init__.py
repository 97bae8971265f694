"""Correction of what moved or differs in this shot: rows, pose, colour, blur, and a verdict on the pair."""
