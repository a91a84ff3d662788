"""The running reference: tables and clocks for the controller, and transitions between motions."""
