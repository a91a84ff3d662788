"""Optimal control: the motion nearest to an animal's that a robot can execute."""
