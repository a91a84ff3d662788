"""Unitree's A1."""
