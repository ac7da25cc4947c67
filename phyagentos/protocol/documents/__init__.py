"""Form of the documents: Markdown with embedded YAML, read with the place of every value."""
