"""The verbs of the command line, related ones in one module; all of them thin over the public API.

Modules here import what is heavy inside `run`, so that `--help` and a mistyped option are answered at once.
"""
