"""Shared foundations: conventions, rotations, small vectors, errors, files, compilation."""
