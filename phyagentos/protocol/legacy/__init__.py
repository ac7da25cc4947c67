"""Import of the documents of the public 0.1.x system: read, converted to drafts, never believed."""
