"""Identifies from a logged run what the controller assumes: the ground's friction and the trunk's payload."""
