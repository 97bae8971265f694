"""Teach a network from the pairs themselves: one training loop."""
