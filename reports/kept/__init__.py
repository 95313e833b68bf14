"""Runs that are kept as a file of the repository, and the pages whose tables are made from it."""
