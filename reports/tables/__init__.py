"""From numbers to tables, and tables as Markdown, LaTeX and JSON."""
