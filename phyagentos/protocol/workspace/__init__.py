"""The workspace folder, its places, and the codecs of the files in it."""
