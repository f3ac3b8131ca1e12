"""Pages of one HTML file: their frame, style and colours."""
