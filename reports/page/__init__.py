"""The page that opens offline in a browser."""
