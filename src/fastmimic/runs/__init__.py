"""Names of motions, and the folders of long work."""
