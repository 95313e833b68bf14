"""Loggers: each shows how a training goes by a library of its own, which nothing else imports."""
