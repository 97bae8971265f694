"""What the user came for: depth files, pictures, bokeh, the report."""
