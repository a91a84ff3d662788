"""A robot to rehearse with: a process of its own that has a real robot's wire, and a simulated body."""
