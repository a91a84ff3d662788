"""What a user names as a motion, and the folders in which work is kept."""
