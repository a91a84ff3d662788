"""Joins several motions into one."""
