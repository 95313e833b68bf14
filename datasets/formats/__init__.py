"""Files that data sets are made of, read and written."""
