"""The reference motion of the controller: tables, clocks, and transitions between motions."""
