"""Data sources of pictures on disk, a file each; `capture` is what they share."""
