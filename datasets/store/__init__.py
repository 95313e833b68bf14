"""What a scene's making remembers and reports: the cache, files' contents, progress."""
