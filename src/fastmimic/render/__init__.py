"""Pictures and videos of robots and animals."""
