"""Steering: a robot that goes where a velocity command points."""
