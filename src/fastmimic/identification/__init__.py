"""What a logged run says of the world that the controller assumes: the ground's friction and the trunk's payload."""
