"""Input: photos, what they state about themselves, and folders of captures."""
