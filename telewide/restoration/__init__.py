"""Restorers: networks that bring the blurred view to the size and sharpness of the other before anything is matched."""
