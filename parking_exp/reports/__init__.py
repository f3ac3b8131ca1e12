"""Reports: frames of results -> numbers, words, pictures and pages."""
