"""Joining motions to one."""
